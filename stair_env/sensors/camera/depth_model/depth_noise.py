"""How large and how wide the errors of a stereo camera's depth are: tables and amounts for `depth_kernels`."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from stair_env.common.validation import SpecError, check_range
from stair_env.sensors.camera.depth_model.depth_unit import DepthUnit
from stair_env.sensors.camera.noise_tiles import TILE_SIDE_PX, gaussian_tile, uniform_tile

if TYPE_CHECKING:
    from stair_env.sensors.camera.depth_error import DepthErrorConfig

BROAD_PX = 40.0  # of the depth imager: correlation of a unit's own error, a tenth of the image's height
STREAK_PX = 2.5  # of the depth imager: correlation of lost bands and false patches across the rows
STREAK_STRETCH = 10.0  # and along them, relative to that
FALSE_IN_BANDS = 0.12  # share of a lost band that reports a false distance instead of none
FALSE_FACTORS = (1.3, 2.2)  # on the disparity of false patches: the next step, or half the distance
FILTERED_NOISE, FILTERED_FRESH = 0.6, 0.4  # what the SDK's filters leave of the noise, and of its change while standing
FILTERED_SPECKLE = 0.3  # of the small blobs
FILTERED_CREASE = 1.4  # how much wider creases become
MAX_CREASE_WINDOW_PX = 41.0


def check_window(name: str, values: Any) -> tuple[float, float]:
    """A range of window sides, low and high, as floats.

    Raises:
        SpecError: values are no such range; the message names the field.
    """
    if not isinstance(values, (tuple, list)) or len(values) != 2:
        raise SpecError(f"{name}={values!r} must be two numbers, low and high")
    low, high = values
    check_range(name, low, 1.0, MAX_CREASE_WINDOW_PX)
    check_range(name, high, low, MAX_CREASE_WINDOW_PX)
    return float(low), float(high)


def after_filters(config: DepthErrorConfig) -> DepthErrorConfig:
    """What is wrong with the depth once the SDK's filters have run, if they are on."""
    if not config.filters:
        return config
    low, high = (min(FILTERED_CREASE * side, MAX_CREASE_WINDOW_PX) for side in config.crease_window_px)
    return dataclasses.replace(
        config,
        filters=False,
        disparity_noise_px=config.disparity_noise_px * FILTERED_NOISE,
        still_share=1.0 - (1.0 - config.still_share) * FILTERED_FRESH**2,
        speckle=config.speckle * FILTERED_SPECKLE,
        single_holes=0.0,
        crease_window_px=(low, high) if high > FILTERED_CREASE else config.crease_window_px,
    )


def noise_px(config: DepthErrorConfig, unit: DepthUnit) -> tuple[np.float32, np.float32, np.float32]:
    """Standard deviations of the disparity: of a frame, of a standing camera, and of a unit."""
    total = config.disparity_noise_px * unit.noise
    fresh = total * math.sqrt(1.0 - config.still_share)
    held = total * math.sqrt(config.still_share)
    return np.float32(fresh), np.float32(held), np.float32(config.structured_px)


def false_patches(config: DepthErrorConfig, unit: DepthUnit, place: int) -> tuple[np.float32, np.float32, np.float32]:
    """Share of the image, share of lost bands, and factor on the disparity, which place (0..TILE_SIDE_PX) chooses."""
    low, high = FALSE_FACTORS
    factor = low + (high - low) * place / TILE_SIDE_PX
    in_bands = FALSE_IN_BANDS if config.false_patches > 0.0 else 0.0
    return np.float32(config.false_patches * unit.severity), np.float32(in_bands), np.float32(factor)


def is_exact(config: DepthErrorConfig, unit: DepthUnit) -> bool:
    """Whether disparities are handed on as they are: neither noise nor steps nor false patches."""
    off = (*noise_px(config, unit), np.float32(config.disparity_quantum_px), *false_patches(config, unit, 0)[:2])
    return not any(value > 0.0 for value in off)


def noise_tables(window_px: float, magnification: float, width: int) -> tuple[np.ndarray, ...]:
    """Two tables of normal noise and three of uniform: `normal, broad, uniform, streaks, white` of the kernels."""
    window = round(window_px * magnification * 4.0) / 4.0  # in steps, so that few tables are made
    broad, streak = (round(size * magnification * 4.0) / 4.0 for size in (BROAD_PX, STREAK_PX))
    # Averaging over a window leaves noise as wide as the window (a Gaussian of a third of its side), the residual error
    # of subpixel interpolation adds the broad dents that planes show in point clouds, and steps of the disparity a
    # little of every wavelength. The shares are fitted to the spectrum of matched depth.
    return (
        gaussian_tile((0.0, window / 3.0, 1.5 * window), (0.02, 0.38, 0.6), width, 0),
        gaussian_tile((broad,), (1.0,), width, 2),
        uniform_tile((window / 3.0, window), (0.5, 0.5), width + 8, 1),
        uniform_tile((0.4 * streak, streak), (0.3, 0.7), width + 8, 3, STREAK_STRETCH),
        uniform_tile((0.0,), (1.0,), width + 8, 4),
    )
