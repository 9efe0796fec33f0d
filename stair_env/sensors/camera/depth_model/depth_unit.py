"""What differs from one depth camera to the next, and stays while one is in use."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stair_env.sensors.camera.noise_tiles import TILE_SIDE_PX

if TYPE_CHECKING:
    from stair_env.intrinsics import Intrinsics
    from stair_env.sensors.camera.depth_error import DepthErrorConfig

NOISE_FACTORS = (0.9, 2.4)  # surfaces of a staircase against the target of the data sheet; fitted to matched depth
REACH_FACTORS = (0.2, 1.2)  # daylight through a window against lamps; likewise


@dataclass(frozen=True)
class DepthUnit:
    """One specimen of the camera in its surroundings.

    Attributes:
        scale_bias: relative depth error.
        focal_error: how much too large the depth image is drawn on the colour image, relative.
        shift_px: the depth image lies so far right and down of the colour image, pixels of the depth imager.
        crease_window_px: side of the window that rounds creases, pixels of the depth imager.
        noise: factor on the disparity's noise, 1 on the well-textured target of the data sheet's figure.
        reach: factor on the projector's range, 1 without light that washes its pattern out.
        severity: factor on lost bands and false patches, 0 to 2: surfaces and light decide about them, and one scene
            shows many, another none.
        place: where in the table of broad noise its own error lies.
    """

    scale_bias: float
    focal_error: float
    shift_px: tuple[float, float]
    crease_window_px: float
    noise: float
    reach: float
    severity: float
    place: tuple[int, int]

    @classmethod
    def typical(cls, config: DepthErrorConfig) -> DepthUnit:
        """The one in the middle of a configuration's ranges."""
        low, high = config.crease_window_px
        return cls(config.scale_bias, 0.0, (0.0, 0.0), 0.5 * (low + high), 1.0, 1.0, 1.0, (0, 0))

    @classmethod
    def draw(cls, config: DepthErrorConfig, rng: np.random.Generator) -> DepthUnit:
        """A specimen at random; the same amount is drawn from rng for every configuration."""
        scale, focal, right, down, window, severity, noise, reach = rng.uniform(-1.0, 1.0, 8)
        row, column = rng.integers(0, TILE_SIDE_PX, 2)
        low, high = config.crease_window_px
        return cls(
            scale_bias=config.scale_bias + config.scale_bias_range * float(scale),
            focal_error=config.focal_error_range * float(focal),
            shift_px=(config.misalignment_px * float(right), config.misalignment_px * float(down)),
            crease_window_px=low + (high - low) * 0.5 * (1.0 + float(window)),
            noise=_between(NOISE_FACTORS, noise),
            reach=_between(REACH_FACTORS, reach),
            severity=1.0 + float(severity),
            place=(int(row), int(column)),
        )

    def off_colour(self, intrinsics: Intrinsics, magnification: float) -> Places:
        """How this unit lays depth over the colour image: shifted and scaled by whole pixels.

        Args:
            intrinsics: of both images.
            magnification: image pixels per pixel of the depth imager.
        """
        return _places(self.shift_px, self.focal_error, intrinsics, magnification)


@dataclass(frozen=True)
class Places:
    """Where each pixel of a depth image comes from.

    Attributes:
        rows: (H,) int64, the row.
        starts: (n + 1,) int64, first column of each of n stretches that are shifted alike, then W.
        sources: (n,) int64, the column that the first of each stretch comes from.
    """

    rows: np.ndarray
    starts: np.ndarray
    sources: np.ndarray


@functools.lru_cache(maxsize=16)
def _places(shift_px: tuple[float, float], focal_error: float, intrinsics: Intrinsics, magnification: float) -> Places:
    right, down = (magnification * shift for shift in shift_px)
    columns = _sources(intrinsics.width, intrinsics.cx, right, focal_error)
    rows = _sources(intrinsics.height, intrinsics.cy, down, focal_error)
    breaks = np.flatnonzero(np.diff(columns) != 1) + 1
    starts = np.concatenate([[0], breaks, [len(columns)]]).astype(np.int64)
    return Places(rows, starts, columns[starts[:-1]])


def _between(bounds: tuple[float, float], drawn: float) -> float:
    """Geometric interpolation, drawn from -1 (the lower bound) to 1."""
    low, high = bounds
    return float(low * (high / low) ** (0.5 * (1.0 + drawn)))


def _sources(count: int, centre: float, shift: float, scale: float) -> np.ndarray:
    """(count,) int64: where along one axis each pixel comes from."""
    middle = np.arange(count) + 0.5 - centre
    places = np.floor(middle / (1.0 + scale) - shift + centre)
    return np.clip(places, 0, count - 1).astype(np.int64)
