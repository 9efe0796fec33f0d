"""From exact depth to what a RealSense D435i reports.

The errors happen where they happen in the device: the scene is turned into disparities of the stereo pair, what one of
the imagers cannot see is lost, matching windows smear edges, disparities are noisy and quantised, matching fails where
there is neither texture nor projected pattern, and the result is scaled by the unit's calibration error and rounded
to millimetres. docs/sensors.md lists every number with its source.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from stair_env.common.validation import SpecError, check_range, from_fields
from stair_env.intrinsics import D435I_COLOUR_OFFSET_M, Intrinsics
from stair_env.sensors.camera.noise_tiles import TILE_SIDE_PX, gaussian_tile, uniform_tile

EDGE_JUMP_PX = 0.5  # disparity step below which a matching window spans an edge without harm
DARK_FRAME_LEVEL = 12.0  # mean of 0-255 up to which brightness says nothing about reflectance
LIT_FRAME_LEVEL = 80.0  # and from which it is taken at its word
DARK_SURFACE_SHARE = 0.25  # of the frame's mean level, under which a surface returns less of the pattern
FULL_TEXTURE_LEVEL = 6.0  # contrast of 0-255 from which matching needs no pattern
MAX_DROP_PROBABILITY = 0.97
_OFFSETS = 12  # random numbers drawn per frame, the same for every configuration


@dataclass(frozen=True)
class DepthErrorConfig:
    """What is wrong with the depth; the defaults are a D435i at 848x480, aligned to colour.

    Args:
        focal_px: focal length of the depth imagers, pixels (data sheet: 87 degrees over 848 pixels).
        baseline_m: between the infrared imagers, metres (data sheet).
        disparity_noise_px: RMS error of the disparity; depth is off by Z^2 s / (f B) (Intel's tuning guide: 0.08 for a
            well-textured target).
        disparity_quantum_px: step of the disparity (1/32: the D4 processor's subpixel resolution), 0 for none.
        depth_unit_m: step of the reported depth (16-bit millimetres), 0 for none.
        scale_bias: relative depth error of this unit before `reset`; 0.01 reads one per cent too far.
        scale_bias_range: `reset` draws the unit's bias evenly within plus and minus this (up to 0.02 uncalibrated).
        occlusion_shadow: lose what the right imager cannot see.
        colour_parallax: lose what the left imager cannot see from 15 mm beside the colour imager.
        flying_share: share of pixels on depth edges that report a mixture of both sides.
        edge_jitter_px: standard deviation of an edge's position, pixels of the depth imager.
        window_px: side of the stereo matcher's window, pixels of the depth imager.
        speckle: share of pixels lost in small blobs everywhere.
        textureless_dropout: probability of a hole where there is neither texture nor pattern.
        dark_dropout: additional probability on far surfaces much darker than the scene, less on near ones.
        specular_dropout: additional probability on saturated highlights.
        projector_range_m: distance up to which the infrared pattern alone suffices; 0 turns the projector off.
        min_range_m, max_range_m: readings outside are dropped (data sheet: 0.18 m at 848x480, about 10 m).

    Raises:
        SpecError: a field is out of range (a ValueError).
    """

    focal_px: float = 447.0
    baseline_m: float = 0.050
    disparity_noise_px: float = 0.08
    disparity_quantum_px: float = 1.0 / 32.0
    depth_unit_m: float = 0.001
    scale_bias: float = 0.0
    scale_bias_range: float = 0.005
    occlusion_shadow: bool = True
    colour_parallax: bool = True
    flying_share: float = 0.25
    edge_jitter_px: float = 0.7
    window_px: float = 5.0
    speckle: float = 0.004
    textureless_dropout: float = 0.9
    dark_dropout: float = 0.35
    specular_dropout: float = 0.6
    projector_range_m: float = 3.5
    min_range_m: float = 0.18
    max_range_m: float = 10.0

    def __post_init__(self) -> None:
        for name, (low, high) in _LIMITS.items():
            check_range(name, getattr(self, name), low, high)
        for name in ("occlusion_shadow", "colour_parallax"):
            if not isinstance(getattr(self, name), bool):
                raise SpecError(f"{name}={getattr(self, name)!r} must be True or False")
        if self.min_range_m >= self.max_range_m:
            raise SpecError(f"min_range_m={self.min_range_m!r} must be below max_range_m={self.max_range_m!r}")

    @classmethod
    def ideal(cls) -> DepthErrorConfig:
        """Nothing is wrong: depth passes through unchanged."""
        off = dict.fromkeys(_ERROR_FIELDS, 0.0)
        return cls(occlusion_shadow=False, colour_parallax=False, max_range_m=1e6, **off)

    @classmethod
    def from_dict(cls, values: Any) -> DepthErrorConfig:
        """Build from a JSON object that names the fields to change from the D435i's.

        Raises:
            SpecError: values is no dict, holds an unknown field or a wrong value.
        """
        built: DepthErrorConfig = from_fields(cls, values, "depth_error")
        return built

    def to_dict(self) -> dict[str, Any]:
        """All fields as a JSON-able dict."""
        return dataclasses.asdict(self)


_ERROR_FIELDS = (
    "disparity_noise_px",
    "disparity_quantum_px",
    "depth_unit_m",
    "scale_bias",
    "scale_bias_range",
    "flying_share",
    "edge_jitter_px",
    "speckle",
    "textureless_dropout",
    "dark_dropout",
    "specular_dropout",
    "min_range_m",
)
_LIMITS: dict[str, tuple[float, float]] = {
    "focal_px": (50.0, 2000.0),
    "baseline_m": (0.01, 0.5),
    "disparity_noise_px": (0.0, 2.0),
    "disparity_quantum_px": (0.0, 1.0),
    "depth_unit_m": (0.0, 0.01),
    "scale_bias": (-0.1, 0.1),
    "scale_bias_range": (0.0, 0.1),
    "flying_share": (0.0, 1.0),
    "edge_jitter_px": (0.0, 5.0),
    "window_px": (1.0, 31.0),
    "speckle": (0.0, 0.5),
    "textureless_dropout": (0.0, 1.0),
    "dark_dropout": (0.0, 1.0),
    "specular_dropout": (0.0, 1.0),
    "projector_range_m": (0.0, 20.0),
    "min_range_m": (0.0, 2.0),
    "max_range_m": (0.5, 1e6),
}


class DepthErrorModel:
    """Applies a `DepthErrorConfig` to frames.

    The unit's calibration error is the only state: `reset` draws it, and until then it is the configured one. Two
    calls of `apply` with generators in equal states give equal frames, whatever was processed in between.

    Args:
        config: what is wrong with the depth.
    """

    def __init__(self, config: DepthErrorConfig | None = None) -> None:
        self.config = config if config is not None else DepthErrorConfig()
        self._scale_bias = self.config.scale_bias
        self._spare: list[np.ndarray] = []

    @property
    def scale_bias(self) -> float:
        """Relative depth error of the present unit."""
        return self._scale_bias

    def reset(self, rng: np.random.Generator) -> None:
        """Take another unit of the camera: draw its calibration error."""
        spread = self.config.scale_bias_range
        self._scale_bias = self.config.scale_bias + float(rng.uniform(-spread, spread))

    def apply(
        self, depth_m: np.ndarray, rgb: np.ndarray, intrinsics: Intrinsics, rng: np.random.Generator
    ) -> np.ndarray:
        """Corrupt one frame.

        Args:
            depth_m: float32 (H, W), exact distance along the optical axis of the colour camera, metres; anything
                but a positive finite number counts as no surface.
            rgb: uint8 (H, W, 3), what the scene looks like before the colour camera's own noise.
            intrinsics: of both images.
            rng: draws where in the noise tables this frame begins, a fixed amount per frame.

        Returns:
            float32 (H, W), metres, 0 = no reading; a new array.

        Raises:
            ValueError: an argument has a wrong shape or dtype.
        """
        return self.begin(depth_m, rgb, intrinsics, rng)()

    def begin(
        self, depth_m: np.ndarray, rgb: np.ndarray, intrinsics: Intrinsics, rng: np.random.Generator
    ) -> Callable[[], np.ndarray]:
        """Draw all that `apply` draws and begin; the function that is returned does the rest, in any thread."""
        _check_frame(depth_m, rgb, intrinsics, rng)
        from stair_env.sensors.camera import depth_kernels as kernels
        from stair_env.sensors.camera.renderers.threads import later

        offsets = rng.integers(0, TILE_SIDE_PX, size=_OFFSETS)
        depth_m = np.ascontiguousarray(depth_m)
        buffers = self._borrow_buffers(depth_m.shape)
        kernels.to_disparity(depth_m, self._focal_baseline(), buffers[0])
        corners = later(lambda: self._hole_corners(rgb, buffers[0]))
        return lambda: self._measure(depth_m, intrinsics, offsets, buffers, corners)

    def _measure(
        self,
        depth_m: np.ndarray,
        intrinsics: Intrinsics,
        offsets: np.ndarray,
        buffers: np.ndarray,
        corners: Callable[[], np.ndarray],
    ) -> np.ndarray:
        """Shadows, edges, noise and holes.

        Args:
            depth_m: exact, (H, W) float32, metres.
            intrinsics: of the image.
            offsets: places in the noise tables where this frame begins.
            buffers: (3, H, W) float32, the first the exact disparity, the others scratch; given back.
            corners: returns the hole probability at the corners of the cells.
        """
        from stair_env.sensors.camera import depth_kernels as kernels

        config, width = self.config, depth_m.shape[1]
        magnification = intrinsics.fx / config.focal_px  # image pixels per pixel of the depth imager
        normal, uniform = _noise_tables(config.window_px * magnification, width)

        mark = np.empty(-(-width // 8) * 8, np.uint8)
        disparity, measured, blurred = buffers
        right, left = _imager_shifts(config, magnification)
        kernels.hide_shadows(disparity, np.float32(right), np.float32(left), np.float32(1.0), mark, measured)
        if config.flying_share > 0.0 or config.edge_jitter_px > 0.0:
            kernels.blur_edges(
                disparity,
                measured,
                max(1, round(config.window_px / 2.0 * magnification)),
                np.float32(EDGE_JUMP_PX),
                np.float32(config.edge_jitter_px * magnification),
                np.float32(config.flying_share),
                normal,
                uniform,
                offsets,
                mark,
                blurred,
            )
            measured = blurred
        out = np.empty_like(depth_m)
        kernels.finish(
            measured,
            depth_m,
            self._focal_baseline(),
            np.float32(config.disparity_noise_px),
            np.float32(config.disparity_quantum_px),
            np.float32(1.0 + self._scale_bias),
            np.float32(config.depth_unit_m),
            np.float32(config.min_range_m),
            np.float32(config.max_range_m),
            corners(),
            normal,
            uniform,
            offsets,
            np.zeros(width + kernels.CELL_PX, np.float32),
            out,
        )
        self._spare.append(buffers)
        return out

    def _focal_baseline(self) -> np.float32:
        """Focal length times baseline of the depth imagers, pixels times metres."""
        return np.float32(self.config.focal_px * self.config.baseline_m)

    def _borrow_buffers(self, shape: tuple[int, ...]) -> np.ndarray:
        """(3, H, W) float32 scratch; fresh pages of memory cost as much as the arithmetic. Safe between threads."""
        while self._spare:
            buffers = self._spare.pop()
            if buffers.shape[1:] == shape:
                return buffers
        return np.empty((3, *shape), np.float32)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_spare": []}

    def _hole_corners(self, rgb: np.ndarray, disparity: np.ndarray) -> np.ndarray:
        """Hole probability at the corners of the cells, (h + 1, w + 1) float32."""
        from stair_env.sensors.camera import depth_kernels as kernels

        rows, columns = (-(-side // kernels.CELL_PX) for side in disparity.shape)
        config = self.config
        if config.speckle + config.textureless_dropout + config.dark_dropout + config.specular_dropout == 0.0:
            return np.zeros((rows + 1, columns + 1), np.float32)
        statistics = [np.empty((rows, columns), np.float32) for _ in range(4)]
        kernels.cell_statistics(np.ascontiguousarray(rgb), disparity, *statistics)
        level, texture, glare, mean_disparity = statistics
        cells = hole_probability(config, level, texture, glare, mean_disparity / self._focal_baseline())
        return _corner_means(cells)


def hole_probability(
    config: DepthErrorConfig, level: np.ndarray, texture: np.ndarray, glare: np.ndarray, inverse_depth: np.ndarray
) -> np.ndarray:
    """How likely matching fails.

    Texture of the surface and the projected pattern each suffice on their own; the pattern fades with the square of
    the distance and on dark surfaces, which is why near ones keep their depth by night. The form and its constants are
    choices of this project, made by eye: nobody has published them.

    Args:
        config: the probabilities and the projector's range.
        level: brightness, 0-255, any shape.
        texture: horizontal contrast, 0-255.
        glare: share of saturated pixels.
        inverse_depth: 1 / metres, 0 for nothing there.

    Returns:
        Probabilities of the same shape, float32, at most MAX_DROP_PROBABILITY.
    """
    reflectance = _reflectance(level)
    reach = np.minimum(config.projector_range_m * inverse_depth, 1e3)  # the bound keeps its square finite
    pattern = np.minimum(reflectance * reach**2, 1.0)
    own = np.minimum(texture / FULL_TEXTURE_LEVEL, 1.0)
    unmatched = (1.0 - own) * (1.0 - pattern)
    probability = (
        config.speckle
        + config.textureless_dropout * unmatched**2
        + config.dark_dropout * (1.0 - reflectance) / np.maximum(reach, 1.0)
        + config.specular_dropout * glare
    )
    return np.minimum(probability, MAX_DROP_PROBABILITY).astype(np.float32)


def _reflectance(level: np.ndarray) -> np.ndarray:
    """Share of the pattern that a surface returns, guessed from its brightness (0-255) among the frame's, 0..1.

    The darker the frame, the more a dark surface is one without light rather than one without reflectance.
    """
    frame_level = max(float(level.mean()), 1e-6)
    trust = min(max((frame_level - DARK_FRAME_LEVEL) / (LIT_FRAME_LEVEL - DARK_FRAME_LEVEL), 0.0), 1.0)
    return 1.0 - trust * (1.0 - np.minimum(level / (DARK_SURFACE_SHARE * frame_level), 1.0))


def depth_rms_m(depth_m: np.ndarray | float, config: DepthErrorConfig) -> np.ndarray:
    """Published RMS error Z^2 s / (f B) at a depth, metres (Intel's tuning guide)."""
    return np.square(depth_m) * config.disparity_noise_px / (config.focal_px * config.baseline_m)


def shadow_width_px(near_m: float, far_m: float, focal_px: float, baseline_m: float) -> float:
    """Width of what a near edge hides from the second imager, f B (1 / near - 1 / far), pixels of focal_px."""
    return focal_px * baseline_m * (1.0 / near_m - 1.0 / far_m)


def _imager_shifts(config: DepthErrorConfig, magnification: float) -> tuple[float, float]:
    """Image pixels per pixel of disparity between the image's viewpoint and the right and left imagers."""
    offset_m = D435I_COLOUR_OFFSET_M if config.colour_parallax else 0.0
    right = (config.baseline_m + offset_m) / config.baseline_m if config.occlusion_shadow else 0.0
    return right * magnification, offset_m / config.baseline_m * magnification


def _noise_tables(window_px: float, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Noise of the disparity, and blobs for holes, as fine as the matching window (image pixels) makes them."""
    window = round(window_px * 4.0) / 4.0
    # Averaging over a window leaves noise as wide as the window (a Gaussian of a third of its side), and the residual
    # error of subpixel interpolation adds the broad dents that planes show in point clouds.
    normal = gaussian_tile((window / 3.0, 1.5 * window), (0.7, 0.3), width, 0)
    uniform = uniform_tile((window / 3.0, window), (0.5, 0.5), width + 8, 1)
    return normal, uniform


def _corner_means(cells: np.ndarray) -> np.ndarray:
    """(h + 1, w + 1) means of the cells around each corner."""
    padded = np.pad(cells, 1, mode="edge")
    return (padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:]) * np.float32(0.25)


def _check_frame(depth_m: np.ndarray, rgb: np.ndarray, intrinsics: Intrinsics, rng: np.random.Generator) -> None:
    if not isinstance(depth_m, np.ndarray) or depth_m.ndim != 2 or depth_m.dtype != np.float32:
        raise ValueError(f"depth_m must be float32 (H, W), got {_describe(depth_m)}")
    if not isinstance(rgb, np.ndarray) or rgb.shape != (*depth_m.shape, 3) or rgb.dtype != np.uint8:
        raise ValueError(f"rgb must be uint8 {(*depth_m.shape, 3)} like depth_m, got {_describe(rgb)}")
    if (intrinsics.height, intrinsics.width) != depth_m.shape:
        raise ValueError(f"intrinsics are {intrinsics.width}x{intrinsics.height}, depth_m is {_describe(depth_m)}")
    if not isinstance(rng, np.random.Generator):
        raise ValueError(f"rng must be a numpy.random.Generator, got {type(rng).__name__}")


def _describe(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape}"
    return type(value).__name__
