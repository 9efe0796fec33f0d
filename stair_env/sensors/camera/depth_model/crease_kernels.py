"""Compiled loops for what a matching window does to shapes: rounded creases.

As in `depth_kernels`, each function is one pass over the image, draws nothing and keeps nothing. Importing this module
loads numba: do so when a frame is processed.
"""

from __future__ import annotations

import numpy as np

from stair_env.common.compiling import njit

_FLAT_PX = np.float32(2e-3)  # rounding of running sums; below it a pixel lies on a plane and is left as it is


@njit(cache=True, nogil=True, error_model="numpy")
def round_creases(
    disparity: np.ndarray,
    half: int,
    limit: np.float32,
    scratch: np.ndarray,
    measured: np.ndarray,
    begin: int = 0,
    end: int = 1 << 30,
) -> None:
    """Replace disparities by their mean over the matching window where the surface is continuous.

    A window that straddles a crease sees both faces and answers with something between them. On a plane the mean is the
    disparity itself, whatever the slant; where it is further off than `limit` the window straddles a jump, not a
    crease, and the pixel stays.

    Args:
        disparity: (H, W) float32 of the scene.
        half: the window reaches that many image pixels to each side; near the border it shrinks to stay centred.
        limit: largest change, depth-imager pixels.
        scratch: (4, at least W) float32.
        measured: (H, W) float32, the same with 0 in shadows; changed in place.
        begin, end: rows to work on. The sums are those of a run from the first row on, wherever it begins.
    """
    height, width = disparity.shape
    zero, one = np.float32(0.0), np.float32(1.0)
    columns, box, sums, other = scratch[0, :width], scratch[1, :width], scratch[2, :width], scratch[3, :width]
    span = max(width - 2 * half, 0)
    columns[:] = zero
    first, last = 0, -1  # rows that the column sums hold
    for v in range(min(end, height)):
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
        if v < begin:
            continue
        per_column = one / np.float32(last - first + 1)
        per_box = per_column / np.float32(2 * half + 1)
        for u in range(width):
            box[u] = columns[u] * per_column
        _add_neighbours(columns, 2 * half + 1, sums, other, box[half : half + span])
        for u in range(half, half + span):
            box[u] *= per_box
        row = measured[v]
        for u in range(width):
            d = row[u]
            change = abs(box[u] - d)
            row[u] = box[u] if (d > zero) & (change > _FLAT_PX) & (change < limit) else d


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _add_neighbours(values: np.ndarray, count: int, sums: np.ndarray, other: np.ndarray, out: np.ndarray) -> None:
    """Fill out (n,) with the sums of `count` neighbours, out[u] = values[u] + ... + values[u + count - 1].

    Sums of 1, 2, 4, 8 neighbours are each made of the ones before, and those that make up `count` are added: half the
    passes of adding one by one, and every one of them made of vector instructions.

    Args:
        values: (n + count - 1,) float32.
        count: positive.
        sums, other: as long as values, scratch; two, because the compiler does not vectorise what overlaps.
        out: (n,) float32, written.
    """
    for u in range(len(values)):
        sums[u] = values[u]
    for u in range(len(out)):
        out[u] = np.float32(0.0)
    size, done = 1, 0
    while size <= count:
        if count & size:
            part = sums[done : done + len(out)]
            for u in range(len(out)):
                out[u] += part[u]
            done += size
        ahead = sums[size:]
        for u in range(len(ahead)):
            other[u] = sums[u] + ahead[u]
        sums, other = other, sums
        size *= 2
