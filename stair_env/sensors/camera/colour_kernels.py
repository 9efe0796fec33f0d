"""Compiled loops of the colour error model. Importing this module loads numba."""

from __future__ import annotations

import numpy as np

from stair_env.common.compiling import njit


@njit(cache=True, nogil=True, error_model="numpy")
def soften(rgb: np.ndarray, weights: np.ndarray, mixed: np.ndarray, blend: np.ndarray, out: np.ndarray) -> None:
    """Convolve with a separable symmetric kernel; the border repeats.

    Args:
        rgb: (H, 3 W) uint8, the image's rows.
        weights: (r + 1,) float32, the kernel's middle and one side.
        mixed: (3 (W + 2 r),) float32, scratch.
        blend: (3 W,) float32, scratch.
        out: (H, 3 W) uint8, written.
    """
    height, width = rgb.shape
    reach = len(weights) - 1
    pad = 3 * reach
    half = np.float32(0.5)
    for v in range(height):
        middle = mixed[pad : pad + width]
        here = rgb[v]
        for i in range(width):
            middle[i] = weights[0] * np.float32(here[i])
        for k in range(1, reach + 1):
            above, below = rgb[max(v - k, 0)], rgb[min(v + k, height - 1)]
            for i in range(width):
                middle[i] += weights[k] * (np.float32(above[i]) + np.float32(below[i]))
        for i in range(pad):
            mixed[i] = middle[i % 3]
            mixed[pad + width + i] = middle[width - 3 + i % 3]
        for i in range(width):
            blend[i] = weights[0] * middle[i] + half
        for k in range(1, reach + 1):
            before, behind = mixed[pad - 3 * k : pad - 3 * k + width], mixed[pad + 3 * k : pad + 3 * k + width]
            for i in range(width):
                blend[i] += weights[k] * (before[i] + behind[i])
        target = out[v]
        for i in range(width):
            target[i] = np.uint8(np.int32(blend[i]))


@njit(cache=True, nogil=True, error_model="numpy")
def smear(rgb: np.ndarray, shifts: np.ndarray, total: np.ndarray, out: np.ndarray) -> None:
    """Mean of the image displaced by whole pixels, as a shutter that stays open while the camera turns.

    Args:
        rgb: (H, 3 W) uint8, the image's rows.
        shifts: (k, 2) int64 displacements (columns, rows), pixels; the border repeats.
        total: (3 W,) uint16, scratch; k is at most 256.
        out: (H, 3 W) uint8, written.
    """
    height, width = rgb.shape
    count = len(shifts)
    per_count = np.float32(1.0 / count)
    half = np.float32(0.5)
    for v in range(height):
        total[:] = 0
        for k in range(count):
            source = rgb[min(max(v + shifts[k, 1], 0), height - 1)]
            offset = min(max(3 * shifts[k, 0], -width), width)
            first, last = max(0, -offset), min(width, width - offset)
            shifted = source[first + offset : last + offset]
            part = total[first:last]
            for i in range(len(part)):
                part[i] += shifted[i]
            for i in range(first):
                total[i] += source[i % 3]
            for i in range(last, width):
                total[i] += source[width - 3 + i % 3]
        target = out[v]
        for i in range(width):
            target[i] = np.uint8(np.int32(np.float32(total[i]) * per_count + half))


@njit(cache=True, nogil=True, error_model="numpy")
def expose(
    rgb: np.ndarray,
    gains: np.ndarray,
    column_radius_2: np.ndarray,
    vignetting: np.float32,
    shot_variance: np.float32,
    read_variance: np.float32,
    noise: np.ndarray,
    offset_v: int,
    offset_u: int,
    out: np.ndarray,
) -> None:
    """Gain, vignetting and noise in one pass.

    Args:
        rgb: (H, 3 W) uint8.
        gains: (3 W,) float32 factor of each channel, repeated along the row.
        column_radius_2: (3 W,) float32 squared horizontal distance from the image centre; 1 is a corner's distance.
        vignetting: share of light lost in the corners.
        shot_variance: variance of the noise per grey level.
        read_variance: variance of the noise without light, squared grey levels.
        noise: (N, 3 (N + W)) float32 of unit variance.
        offset_v, offset_u: pixel in the noise where this frame begins.
        out: (H, 3 W) uint8, written.
    """
    height, width = rgb.shape
    one, half = np.float32(1.0), np.float32(0.5)
    black, white = np.float32(0.0), np.float32(255.0)
    aspect_2 = np.float32((3.0 * height / width) ** 2)
    row_share = aspect_2 / (one + aspect_2)
    for v in range(height):
        y = np.float32((2.0 * v + 1.0) / height - 1.0)
        fall_off = one - vignetting * row_share * y * y
        random = noise[(v + offset_v) % noise.shape[0], 3 * offset_u :]
        source, target = rgb[v], out[v]
        for i in range(width):
            value = np.float32(source[i]) * gains[i] * (fall_off - vignetting * column_radius_2[i])
            value += random[i] * np.sqrt(read_variance + shot_variance * value) + half
            target[i] = np.uint8(np.int32(min(max(value, black), white)))
