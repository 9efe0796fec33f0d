"""Compiled anti-aliasing: more rays through the pixels that an outline, a crease or a shadow's border crosses.

The extra rays are packed into an image of their own, one tile wide, which `visibility` and `shading` draw like any
other.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stair_env.common.compiling import njit

TILE = 16  # pixels, as in `visibility`
SAMPLES = 4
GROUP = 8 * TILE * TILE // SAMPLES  # pixels that are drawn again together; they fill eight tiles with their rays
# A rotated grid: no two samples share a row or a column, so that near-level and near-upright edges get four steps.
_OFFSET_U = (np.float32(-0.125), np.float32(0.375), np.float32(-0.375), np.float32(0.125))
_OFFSET_V = (np.float32(-0.375), np.float32(-0.125), np.float32(0.125), np.float32(0.375))
_CENTRE = np.float32(0.5)
_MIN_CONTRAST = 16  # sum over the channels, of 765, from which on a border shows

kernel: Any = njit(cache=True, nogil=True, error_model="numpy")


@kernel
def _differ(regions, rgb, v, u, other_v, other_u):  # type: ignore[no-untyped-def]
    if regions[v, u] == regions[other_v, other_u]:
        return False
    red = abs(np.int32(rgb[v, u, 0]) - np.int32(rgb[other_v, other_u, 0]))
    green = abs(np.int32(rgb[v, u, 1]) - np.int32(rgb[other_v, other_u, 1]))
    blue = abs(np.int32(rgb[v, u, 2]) - np.int32(rgb[other_v, other_u, 2]))
    return red + green + blue >= _MIN_CONTRAST


@kernel
def _mark_borders(above, here, below, marks):  # type: ignore[no-untyped-def]
    """Set marks (at least W,) to 1 where a pixel's region is not that of all four neighbours, else to 0."""
    width = here.shape[0]
    for u in range(width):
        marks[u] = (above[u] != here[u]) | (below[u] != here[u])
    # Slices, because an index that might be negative keeps the compiler from using vector instructions.
    left, right, marks_left, marks_right = here[:-1], here[1:], marks[: width - 1], marks[1:width]
    for u in range(width - 1):
        marks_left[u] |= np.uint8(left[u] != right[u])
    for u in range(width - 1):
        marks_right[u] |= np.uint8(left[u] != right[u])


@kernel
def find_borders(rows, regions, rgb, pixels, counts):  # type: ignore[no-untyped-def]
    """List the pixels beside a visible border, tile by tile.

    Args:
        rows: (k,) int64 indices of the rows of tiles to look at.
        regions, rgb: as written by `shading.shade_rows`.
        pixels: (rows of tiles, TILE * W) int64 out, v * W + u.
        counts: (rows of tiles,) int64 out, how many were found in each row.
    """
    height, width = regions.shape
    marks = np.zeros((TILE, -(-width // TILE) * TILE), np.uint8)
    marks_of_8 = marks.view(np.uint64)  # most of them are all zero, and cheaper to skip together
    for row in rows:
        count = 0
        for v in range(row * TILE, min(row * TILE + TILE, height)):
            _mark_borders(regions[max(v - 1, 0)], regions[v], regions[min(v + 1, height - 1)], marks[v - row * TILE])
        for u0 in range(0, width, TILE):
            for v in range(row * TILE, min(row * TILE + TILE, height)):
                eighths = marks_of_8[v - row * TILE]
                if eighths[u0 // 8] == 0 and eighths[u0 // 8 + 1] == 0:
                    continue
                above, below = max(v - 1, 0), min(v + 1, height - 1)
                for u in range(u0, min(u0 + TILE, width)):
                    left, right = max(u - 1, 0), min(u + 1, width - 1)
                    if marks[v - row * TILE, u] != 0 and (
                        _differ(regions, rgb, v, u, v, left)
                        or _differ(regions, rgb, v, u, v, right)
                        or _differ(regions, rgb, v, u, above, u)
                        or _differ(regions, rgb, v, u, below, u)
                    ):
                        pixels[row, count] = v * width + u
                        count += 1
        counts[row] = count


@kernel
def spread_rays(pixels, width, cx, cy, slope_x, slope_y, sample_x, sample_y):  # type: ignore[no-untyped-def]
    """Slopes of SAMPLES rays through each pixel.

    Args:
        pixels: (n,) int64, at least one.
        width: of the image, pixels.
        cx, cy: float32 principal point, pixels.
        slope_x, slope_y: float32 change of slope from pixel to pixel.
        sample_x, sample_y: (s,) float32 out, s >= n * SAMPLES; what is left over repeats the last ray.
    """
    used = 0
    for pixel in pixels:
        v = pixel // width
        x, y = np.float32(pixel - v * width) + _CENTRE - cx, np.float32(v) + _CENTRE - cy
        for sample in range(SAMPLES):
            sample_x[used] = (x + _OFFSET_U[sample]) * slope_x
            sample_y[used] = (y + _OFFSET_V[sample]) * slope_y
            used += 1
    sample_x[used:] = sample_x[used - 1]
    sample_y[used:] = sample_y[used - 1]


@kernel
def average_samples(pixels, samples, rgb):  # type: ignore[no-untyped-def]
    """Put the mean of each pixel's samples, (s, 3) uint8, into the image, (H, W, 3) uint8."""
    width = rgb.shape[1]
    for k in range(pixels.shape[0]):
        v = pixels[k] // width
        u = pixels[k] - v * width
        for channel in range(3):
            total = np.float32(0.0)
            for sample in range(SAMPLES):  # light adds up, its code does not: the square is close to linear
                value = np.float32(samples[k * SAMPLES + sample, channel])
                total += value * value
            rgb[v, u, channel] = np.uint8(np.sqrt(total / np.float32(SAMPLES)) + np.float32(0.5))
