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
from typing import TYPE_CHECKING, Any

import numpy as np

from stair_env.camera.depth_holes import hole_corners
from stair_env.camera.depth_noise import after_filters, check_window, false_patches, noise_px, noise_tables
from stair_env.camera.depth_unit import DepthUnit
from stair_env.camera.noise_tiles import TILE_SIDE_PX
from stair_env.stairs import SpecError, check_range, from_fields

if TYPE_CHECKING:
    from stair_env.camera.intrinsics import Intrinsics

COLOUR_OFFSET_M = 0.015  # colour imager left of the left infrared imager (data sheet; extrinsics read from devices)
EDGE_JUMP_PX = 0.5  # disparity step below which a matching window spans an edge without harm
CREASE_LIMIT_PX = 0.75  # of disparity; what a window's mean is further off is a jump, where one side wins
_OFFSETS = 22  # random numbers drawn per frame, the same for every configuration
_FRESH = [8, 9, 16, 17]  # those that change even while the camera stands still: noise and single holes


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
        fattened_share: share of those that report the near side.
        edge_jitter_px: standard deviation of an edge's position, pixels of the depth imager.
        window_px: side of the stereo matcher's window, pixels of the depth imager.
        crease_window_px: side of the window that rounds creases, pixels of the depth imager; [low, high], drawn by
            `reset`. (1, 1) keeps them sharp.
        structured_px: standard deviation of an error that varies over a tenth of the image and stays with the unit,
            pixels of disparity.
        still_share: share of the noise's variance that stays from frame to frame before a standing camera.
        single_holes: share of pixels lost one by one.
        lost_treads: probability that a band along the rows is lost where a surface bends and has no texture; `reset`
            draws a factor of 0 to 2 on it.
        false_patches: share of pixels in patches that report too near a distance; lost bands hold more of them.
        focal_error_range: `reset` draws by how much the depth image is too large, relative, plus and minus this.
        misalignment_px: `reset` draws a shift against colour within plus and minus this, pixels of the depth imager.
        filters: the SDK's post-processing is on: less noise, no single holes, rounder creases.
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
    fattened_share: float = 0.2
    window_px: float = 5.0
    crease_window_px: tuple[float, float] = (9.0, 21.0)
    structured_px: float = 0.08
    still_share: float = 0.6
    single_holes: float = 0.003
    lost_treads: float = 0.4
    false_patches: float = 0.002
    focal_error_range: float = 0.003
    misalignment_px: float = 1.5
    filters: bool = False
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
        for name in ("occlusion_shadow", "colour_parallax", "filters"):
            if not isinstance(getattr(self, name), bool):
                raise SpecError(f"{name}={getattr(self, name)!r} must be True or False")
        if self.min_range_m >= self.max_range_m:
            raise SpecError(f"min_range_m={self.min_range_m!r} must be below max_range_m={self.max_range_m!r}")
        object.__setattr__(self, "crease_window_px", check_window("crease_window_px", self.crease_window_px))

    @classmethod
    def ideal(cls) -> DepthErrorConfig:
        """Nothing is wrong: depth passes through unchanged."""
        off: dict[str, Any] = dict.fromkeys(_ERROR_FIELDS, 0.0)
        return cls(occlusion_shadow=False, colour_parallax=False, crease_window_px=(1.0, 1.0), max_range_m=1e6, **off)

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
    "fattened_share",
    "edge_jitter_px",
    "structured_px",
    "single_holes",
    "lost_treads",
    "false_patches",
    "focal_error_range",
    "misalignment_px",
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
    "fattened_share": (0.0, 1.0),
    "structured_px": (0.0, 2.0),
    "still_share": (0.0, 1.0),
    "single_holes": (0.0, 0.5),
    "lost_treads": (0.0, 1.0),
    "false_patches": (0.0, 0.5),
    "focal_error_range": (0.0, 0.05),
    "misalignment_px": (0.0, 10.0),
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

    The unit is a state: `reset` draws it, and until then it is the typical one. For a camera that stands still, so is
    where in the noise tables the last frame began; otherwise two calls of `apply` with generators in equal states give
    equal frames, whatever was processed in between.

    Args:
        config: what is wrong with the depth.
    """

    def __init__(self, config: DepthErrorConfig | None = None) -> None:
        self.config = config if config is not None else DepthErrorConfig()
        self._effective = after_filters(self.config)
        self._unit = DepthUnit.typical(self._effective)
        self._offsets: np.ndarray | None = None
        self._spare: list[np.ndarray] = []

    @property
    def unit(self) -> DepthUnit:
        """The present specimen of the camera."""
        return self._unit

    @property
    def scale_bias(self) -> float:
        """Relative depth error of the present unit."""
        return self._unit.scale_bias

    def reset(self, rng: np.random.Generator) -> None:
        """Take another unit of the camera: draw its calibration errors, its window and its surroundings."""
        self._unit = DepthUnit.draw(self._effective, rng)
        self._offsets = None

    def apply(
        self,
        depth_m: np.ndarray,
        rgb: np.ndarray,
        intrinsics: Intrinsics,
        rng: np.random.Generator,
        standing: bool = False,
    ) -> np.ndarray:
        """Corrupt one frame.

        Args:
            depth_m: float32 (H, W), exact distance along the optical axis of the colour camera, metres; anything
                but a positive finite number counts as no surface.
            rgb: uint8 (H, W, 3), what the scene looks like before the colour camera's own noise.
            intrinsics: of both images.
            rng: draws where in the noise tables this frame begins, a fixed amount per frame.
            standing: nothing has moved since the last frame, so that part of its errors stays.

        Returns:
            float32 (H, W), metres, 0 = no reading; a new array.

        Raises:
            ValueError: an argument has a wrong shape or dtype.
        """
        return self.begin(depth_m, rgb, intrinsics, rng, standing)()

    def begin(
        self,
        depth_m: np.ndarray,
        rgb: np.ndarray,
        intrinsics: Intrinsics,
        rng: np.random.Generator,
        standing: bool = False,
    ) -> Callable[[], np.ndarray]:
        """Draw all that `apply` draws and begin; the function that is returned does the rest, in any thread."""
        _check_frame(depth_m, rgb, intrinsics, rng)
        from stair_env.camera import depth_kernels as kernels
        from stair_env.camera.renderers.threads import later

        offsets = self._place_in_tables(rng, standing)
        unit = self._unit
        depth_m = unit.off_colour(np.ascontiguousarray(depth_m), intrinsics, intrinsics.fx / self.config.focal_px)
        buffers = self._borrow_buffers(depth_m.shape)
        kernels.to_disparity(depth_m, self._focal_baseline(), buffers[0])
        corners = later(lambda: hole_corners(self._effective, unit, rgb, buffers[0]))
        return lambda: self._measure(depth_m, intrinsics, unit, offsets, buffers, corners)

    def _place_in_tables(self, rng: np.random.Generator, standing: bool) -> np.ndarray:
        """(_OFFSETS,) int64 where in the noise tables a frame begins."""
        offsets = rng.integers(0, TILE_SIDE_PX, size=_OFFSETS)
        if standing and self._offsets is not None:
            offsets = np.where(np.isin(np.arange(_OFFSETS), _FRESH), offsets, self._offsets)
        self._offsets = offsets
        return offsets

    def _measure(
        self,
        depth_m: np.ndarray,
        intrinsics: Intrinsics,
        unit: DepthUnit,
        offsets: np.ndarray,
        buffers: np.ndarray,
        corners: Callable[[], np.ndarray],
    ) -> np.ndarray:
        """Shadows, creases, edges, noise and holes.

        Args:
            depth_m: exact, (H, W) float32, metres.
            intrinsics: of the image.
            unit: of the camera.
            offsets: places in the noise tables where this frame begins.
            buffers: (3, H, W) float32, the first the exact disparity, the others scratch; given back.
            corners: returns `hole_corners`.
        """
        from stair_env.camera import crease_kernels
        from stair_env.camera import depth_kernels as kernels

        config, width = self._effective, depth_m.shape[1]
        magnification = intrinsics.fx / config.focal_px  # image pixels per pixel of the depth imager
        normal, broad, uniform, streaks, white = noise_tables(config.window_px, magnification, width)

        mark = np.empty(-(-width // 8) * 8, np.uint8)
        scratch = np.zeros((4, width + kernels.CELL_PX), np.float32)
        disparity, measured, blurred = buffers
        right, left = _imager_shifts(config, magnification)
        kernels.hide_shadows(disparity, np.float32(right), np.float32(left), np.float32(1.0), mark, measured)
        half = round((unit.crease_window_px * magnification - 1.0) / 2.0)
        if half > 0:
            limit = np.float32(CREASE_LIMIT_PX)
            crease_kernels.round_creases(disparity, half, limit, scratch, measured)
        if config.flying_share + config.fattened_share > 0.0 or config.edge_jitter_px > 0.0:
            kernels.blur_edges(
                disparity,
                measured,
                max(1, round(config.window_px / 2.0 * magnification)),
                np.float32(EDGE_JUMP_PX),
                np.float32(config.edge_jitter_px * magnification),
                np.float32(config.flying_share),
                np.float32(config.fattened_share),
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
            noise_px(config, unit),
            np.float32(config.disparity_quantum_px),
            np.float32(1.0 + unit.scale_bias),
            np.float32(config.depth_unit_m),
            (np.float32(config.min_range_m), np.float32(config.max_range_m)),
            np.float32(config.single_holes),
            false_patches(config, unit, int(offsets[20])),
            corners(),
            normal,
            broad,
            uniform,
            streaks,
            white,
            offsets,
            unit.place,
            scratch,
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


def depth_rms_m(depth_m: np.ndarray | float, config: DepthErrorConfig) -> np.ndarray:
    """Published RMS error Z^2 s / (f B) at a depth, metres (Intel's tuning guide)."""
    return np.square(depth_m) * config.disparity_noise_px / (config.focal_px * config.baseline_m)


def shadow_width_px(near_m: float, far_m: float, focal_px: float, baseline_m: float) -> float:
    """Width of what a near edge hides from the second imager, f B (1 / near - 1 / far), pixels of focal_px."""
    return focal_px * baseline_m * (1.0 / near_m - 1.0 / far_m)


def _imager_shifts(config: DepthErrorConfig, magnification: float) -> tuple[float, float]:
    """Image pixels per pixel of disparity between the image's viewpoint and the right and left imagers."""
    offset_m = COLOUR_OFFSET_M if config.colour_parallax else 0.0
    right = (config.baseline_m + offset_m) / config.baseline_m if config.occlusion_shadow else 0.0
    return right * magnification, offset_m / config.baseline_m * magnification


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
