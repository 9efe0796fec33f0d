"""Compiled loops for what a matching window does to shapes: rounded creases, and a depth image off its colour image.

As in `depth_kernels`, each function is one pass over the image, draws nothing and keeps nothing. Importing this module
loads numba: do so when a frame is processed.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_FLAT_PX = np.float32(2e-3)  # rounding of running sums; below it a pixel lies on a plane and is left as it is


@njit(cache=True, nogil=True, error_model="numpy")
def round_creases(
    disparity: np.ndarray, half: int, limit: np.float32, columns: np.ndarray, box: np.ndarray, measured: np.ndarray
) -> None:
    """Replace disparities by their mean over the matching window where the surface is continuous.

    A window that straddles a crease sees both faces and answers with something between them. On a plane the mean is the
    disparity itself, whatever the slant; where it is further off than `limit` the window straddles a jump, not a
    crease, and the pixel stays.

    Args:
        disparity: (H, W) float32 of the scene.
        half: the window reaches that many image pixels to each side; near the border it shrinks to stay centred.
        limit: largest change, depth-imager pixels.
        columns, box: (W,) float32, scratch.
        measured: (H, W) float32, the same with 0 in shadows; changed in place.
    """
    height, width = disparity.shape
    zero, one = np.float32(0.0), np.float32(1.0)
    span = max(width - 2 * half, 0)
    columns[:] = zero
    first, last = 0, -1  # rows that the column sums hold
    for v in range(height):
        reach = min(half, v, height - 1 - v)
        while last < v + reach:
            last += 1
            entering = disparity[last]
            for u in range(width):
                columns[u] += entering[u]
        while first < v - reach:
            leaving = disparity[first]
            for u in range(width):
                columns[u] -= leaving[u]
            first += 1
        per_column = one / np.float32(last - first + 1)
        per_box = per_column / np.float32(2 * half + 1)
        for u in range(width):
            box[u] = columns[u] * per_column
        inner = box[half : half + span]
        for u in range(span):
            inner[u] = zero
        for shift in range(2 * half + 1):
            shifted = columns[shift : shift + span]
            for u in range(span):
                inner[u] += shifted[u]
        for u in range(span):
            inner[u] *= per_box
        row = measured[v]
        for u in range(width):
            d = row[u]
            change = abs(box[u] - d)
            row[u] = box[u] if (d > zero) & (change > _FLAT_PX) & (change < limit) else d


@njit(cache=True, nogil=True, error_model="numpy")
def resample(image: np.ndarray, rows: np.ndarray, starts: np.ndarray, sources: np.ndarray, out: np.ndarray) -> None:
    """Copy an image from elsewhere: out[v, u] = image[rows[v], u + shift], shift constant over a stretch.

    Args:
        image: (H, W) float32.
        rows: (H,) int64, row to take.
        starts: (n + 1,) int64, first column of each of the n stretches, then W.
        sources: (n,) int64, column to take for the first of each stretch.
        out: (H, W) float32, written.
    """
    for v in range(len(rows)):
        row, target = image[rows[v]], out[v]
        for i in range(len(sources)):
            count = starts[i + 1] - starts[i]
            taken, given = row[sources[i] : sources[i] + count], target[starts[i] : starts[i + 1]]
            for u in range(count):
                given[u] = taken[u]
