"""From exact depth to what a RealSense D435i reports.

The errors happen where they happen in the device: the scene is turned into disparities of the stereo pair, what one of
the imagers cannot see is lost, matching windows smear edges, disparities are noisy and quantised, matching fails where
there is neither texture nor projected pattern, and the result is scaled by the unit's calibration error and rounded
to millimetres. docs/sensors.md lists every number with its source.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from stair_env.intrinsics import D435I_COLOUR_OFFSET_M, Intrinsics
from stair_env.sensors.camera.depth_model.depth_config import DepthErrorConfig
from stair_env.sensors.camera.depth_model.depth_holes import hole_corners
from stair_env.sensors.camera.depth_model.depth_noise import (
    after_filters,
    false_patches,
    is_exact,
    noise_px,
    noise_tables,
)
from stair_env.sensors.camera.depth_model.depth_unit import DepthUnit
from stair_env.sensors.camera.noise_tiles import TILE_SIDE_PX

__all__ = ["DepthErrorConfig", "DepthErrorModel", "depth_rms_m", "shadow_width_px"]

EDGE_JUMP_PX = 0.5  # disparity step below which a matching window spans an edge without harm
CREASE_LIMIT_PX = 0.75  # of disparity; what a window's mean is further off is a jump, where one side wins
_OFFSETS = 22  # random numbers drawn per frame, the same for every configuration
# Those that change even while the camera stands still: noise and single holes.
_FRESH = np.isin(np.arange(_OFFSETS), [8, 9, 16, 17])


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
        seen_m: tuple[float, float] = (0.0, math.inf),
    ) -> Callable[[], np.ndarray]:
        """Draw all that `apply` draws and begin; the function that is returned does the rest, in any thread.

        Args:
            depth_m, rgb, intrinsics, rng, standing: as for `apply`.
            seen_m: depths outside, nearest to farthest, count as no surface.
        """
        _check_frame(depth_m, rgb, intrinsics, rng)
        from stair_env.sensors.camera.depth_model import scene_kernels as kernels
        from stair_env.sensors.camera.renderers.threads import later, run_rows

        offsets = self._place_in_tables(rng, standing)
        unit, config = self._unit, self._effective
        depth_m, rgb = np.ascontiguousarray(depth_m), np.ascontiguousarray(rgb)
        magnification = intrinsics.fx / config.focal_px  # image pixels per pixel of the depth imager
        buffers = self._borrow_buffers(depth_m.shape)
        disparity, measured, exact_m = buffers
        exact_m = exact_m if is_exact(config, unit) else exact_m[:0]
        places, shifts = unit.off_colour(intrinsics, magnification), _imager_shifts(config, magnification)
        nearest_m, farthest_m = seen_m
        range_m = np.float32(nearest_m), np.float32(farthest_m)
        rows, columns = (-(-side // kernels.CELL_PX) for side in depth_m.shape)
        statistics = np.empty((4, rows, columns), np.float32)
        focal_baseline = self._focal_baseline()

        def see(cells: np.ndarray) -> None:
            kernels.see_rows(
                cells, depth_m, rgb, range_m, focal_baseline, places.rows, places.starts, places.sources, shifts,
                exact_m, disparity, measured, statistics,
            )  # fmt: skip

        run_rows(see, rows)
        corners = later(lambda: hole_corners(config, unit, statistics))
        return lambda: self._measure(magnification, unit, offsets, buffers, exact_m, corners)

    def _place_in_tables(self, rng: np.random.Generator, standing: bool) -> np.ndarray:
        """(_OFFSETS,) int64 where in the noise tables a frame begins."""
        offsets = rng.integers(0, TILE_SIDE_PX, size=_OFFSETS)
        if standing and self._offsets is not None:
            offsets = np.where(_FRESH, offsets, self._offsets)
        self._offsets = offsets
        return offsets

    def _measure(
        self,
        magnification: float,
        unit: DepthUnit,
        offsets: np.ndarray,
        buffers: np.ndarray,
        exact_m: np.ndarray,
        corners: Callable[[], np.ndarray],
    ) -> np.ndarray:
        """Creases, edges, noise and holes.

        Args:
            magnification: image pixels per pixel of the depth imager.
            unit: of the camera.
            offsets: places in the noise tables where this frame begins.
            buffers: (3, H, W) float32, the exact disparity, the same with shadows, and scratch; given back.
            exact_m: (H, W) float32, exact depth, metres; (0, W) where it is not needed.
            corners: returns `hole_corners`.
        """
        from stair_env.sensors.camera.depth_model import depth_kernels as kernels
        from stair_env.sensors.camera.renderers.threads import run_rows

        config = self._effective
        disparity, measured, _ = buffers
        height, width = disparity.shape
        normal, broad, uniform, streaks, white = noise_tables(config.window_px, magnification, width)
        self._round_creases(disparity, measured, round((unit.crease_window_px * magnification - 1.0) / 2.0))
        blurred = config.flying_share + config.fattened_share > 0.0 or config.edge_jitter_px > 0.0
        reach = max(1, round(config.window_px / 2.0 * magnification)) if blurred else 0
        jitter_px = config.edge_jitter_px * magnification
        edges = tuple(
            np.float32(value) for value in (EDGE_JUMP_PX, jitter_px, config.flying_share, config.fattened_share)
        )
        focal_baseline, noise = self._focal_baseline(), noise_px(config, unit)
        quantum_px, unit_m = np.float32(config.disparity_quantum_px), np.float32(config.depth_unit_m)
        scale, single = np.float32(1.0 + unit.scale_bias), np.float32(config.single_holes)
        range_m = np.float32(config.min_range_m), np.float32(config.max_range_m)
        patches, chances = false_patches(config, unit, int(offsets[20])), corners()
        out = np.empty((height, width), np.float32)

        def measure(bands: np.ndarray) -> None:
            kernels.measure_rows(
                bands, disparity, measured, exact_m, reach, edges, focal_baseline, noise, quantum_px, scale, unit_m,
                range_m, single, patches, chances, normal, broad, uniform, streaks, white, offsets, unit.place, out,
            )  # fmt: skip

        run_rows(measure, -(-height // kernels.BAND_PX))
        self._spare.append(buffers)
        return out

    def _round_creases(self, disparity: np.ndarray, measured: np.ndarray, half: int) -> None:
        """Round the creases of measured (H, W), in place, by windows that reach half pixels to each side."""
        if half <= 0:
            return
        from stair_env.sensors.camera.depth_model import crease_kernels
        from stair_env.sensors.camera.renderers.threads import default_threads, run_rows

        height, width = disparity.shape
        parts = default_threads()  # as few as possible: each repeats the sums of the rows above it

        def round_part(chosen: np.ndarray) -> None:
            scratch = np.empty((4, width), np.float32)
            for part in chosen.tolist():
                begin, end = (height * edge // parts for edge in (part, part + 1))
                crease_kernels.round_creases(
                    disparity, half, np.float32(CREASE_LIMIT_PX), scratch, measured, begin, end
                )

        run_rows(round_part, parts)

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


def _imager_shifts(config: DepthErrorConfig, magnification: float) -> tuple[np.float32, np.float32]:
    """Image pixels per pixel of disparity between the image's viewpoint and the right and left imagers."""
    offset_m = D435I_COLOUR_OFFSET_M if config.colour_parallax else 0.0
    right = (config.baseline_m + offset_m) / config.baseline_m if config.occlusion_shadow else 0.0
    return np.float32(right * magnification), np.float32(offset_m / config.baseline_m * magnification)


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
