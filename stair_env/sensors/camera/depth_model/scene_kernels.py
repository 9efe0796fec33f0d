"""Compiled loops from a drawn depth image to what the two imagers of a stereo camera have in common.

As in `depth_kernels`, everything works on disparities, nothing is drawn and nothing kept, and every pixel depends on
its inputs alone, so that results do not depend on how the rows are divided. Importing this module loads numba: do so
when a frame is processed.
"""

from __future__ import annotations

import numpy as np

from stair_env.common.compiling import njit

CELL_PX = 8  # side of the squares over which texture and brightness are averaged; as in `depth_kernels`
_HIDDEN = np.float32(0.0)
_GLARE = np.int32(250)  # level from which a pixel counts as saturated


@njit(cache=True, nogil=True, error_model="numpy")
def see_rows(
    cells: np.ndarray,
    depth_m: np.ndarray,
    rgb: np.ndarray,
    range_m: tuple[np.float32, np.float32],
    focal_baseline: np.float32,
    rows: np.ndarray,
    starts: np.ndarray,
    sources: np.ndarray,
    shifts: tuple[np.float32, np.float32],
    exact_m: np.ndarray,
    disparity: np.ndarray,
    measured: np.ndarray,
    statistics: np.ndarray,
) -> None:
    """Lay depth over the colour image as a unit does, turn it into disparity, hide shadows, average over cells.

    Args:
        cells: (k,) int64 rows of cells to work on, CELL_PX image rows each.
        depth_m: (H, W) float32 of the scene, metres.
        rgb: (H, W, 3) uint8.
        range_m: nearest and farthest depth that is there at all.
        focal_baseline: focal length times baseline of the depth imagers, pixels times metres.
        rows: (H,) int64, row of depth_m that each row shows.
        starts: (n + 1,) int64, first column of each of n stretches, then W.
        sources: (n,) int64, column of depth_m that the first of each stretch shows; the others follow it.
        shifts: image pixels of displacement per pixel of disparity of the two imagers, see `_hide_row`.
        exact_m: (H, W) float32, written: depth laid over; (0, 0) where it is not wanted.
        disparity: (H, W) float32, written: f B / z, 0 where depth is not a positive finite number.
        measured: (H, W) float32, written: the same, 0 in shadows too.
        statistics: (4, h, w) float32, written, see `_average_cells`.
    """
    height, width = disparity.shape
    row_m = np.empty(width, np.float32)
    mark = np.zeros(-(-width // 8) * 8, np.uint8)
    samples = -(-width // 2)
    green = np.zeros(samples + 1, np.int32)
    sums, near = np.empty((4, samples), np.int32), np.empty(samples, np.float32)
    for cell in cells:
        first, end = cell * CELL_PX, min((cell + 1) * CELL_PX, height)
        for v in range(first, end):
            _lay_over(depth_m[rows[v]], starts, sources, range_m, row_m)
            _to_disparity(row_m, focal_baseline, disparity[v])
            _hide_row(disparity[v], shifts[0], shifts[1], mark, measured[v])
            if exact_m.shape[0] > 0:
                exact_m[v] = row_m
        _average_cells(rgb, disparity, first, end, green, sums, near, statistics[:, cell])


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _lay_over(
    row_m: np.ndarray,
    starts: np.ndarray,
    sources: np.ndarray,
    range_m: tuple[np.float32, np.float32],
    out: np.ndarray,
) -> None:
    """Copy a row (W,) stretch by stretch, with 0 in place of what is out of range."""
    zero = np.float32(0.0)
    for i in range(len(sources)):
        count = starts[i + 1] - starts[i]
        taken, given = row_m[sources[i] : sources[i] + count], out[starts[i] : starts[i + 1]]
        for u in range(count):
            z = taken[u]
            given[u] = z if (z >= range_m[0]) & (z <= range_m[1]) else zero


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _to_disparity(depth_m: np.ndarray, focal_baseline: np.float32, disparity: np.ndarray) -> None:
    """Fill disparity (W,) with f B / z; 0 where depth is not a positive finite number."""
    zero, one, huge = np.float32(0.0), np.float32(1.0), np.float32(1e6)
    for u in range(len(disparity)):
        z = depth_m[u]
        usable = (z > zero) & (z < huge)  # false for NaN and for infinity
        disparity[u] = focal_baseline / (z if usable else one) if usable else zero


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _hide_row(row: np.ndarray, shift: np.float32, shift_2: np.float32, mark: np.ndarray, out: np.ndarray) -> None:
    """Copy disparities (W,) and set to 0 what a camera further to the right cannot see.

    A camera displaced to the right by b sees pixel u at u - shift d, shift = (f_image / f_depth) (b / B). A near
    surface whose left edge lies at u therefore hides a strip of shift (d_near - d_far) pixels of whatever is behind
    it, to the left of that edge, and nothing on any other side.

    Args:
        row: (W,) float32 disparities of the scene.
        shift, shift_2: of two cameras; 0 leaves one out.
        mark: (a multiple of 8, at least W,) uint8 scratch, zeros behind the row.
        out: (W,) float32, written.
    """
    wall = np.float32(1.0)  # smallest displacement between neighbours that hides a whole pixel, image pixels
    strongest = max(shift, shift_2)
    for u in range(len(row)):
        out[u] = row[u]
    if strongest <= 0.0 or not _mark_walls(row, strongest, wall, mark):
        return
    marks_of_8 = mark.view(np.uint64)  # most of them are all zero, and cheaper to skip together
    for eighth in range(len(marks_of_8)):
        if marks_of_8[eighth] != 0:
            for u in range(8 * eighth, min(8 * eighth + 8, len(row) - 1)):
                if mark[u] != 0:
                    _shade_strip(row, out, u, shift, wall)
                    _shade_strip(row, out, u, shift_2, wall)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _mark_walls(row: np.ndarray, shift: np.float32, wall: np.float32, mark: np.ndarray) -> bool:
    """Set mark to 1 left of where disparity rises enough to hide a pixel; whether it does anywhere."""
    here, there = row[:-1], row[1:]
    marks = 0
    for u in range(len(there)):
        mark[u] = shift * (there[u] - here[u]) >= wall
    for u in range(len(there)):
        marks += mark[u]
    return marks > 0


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _shade_strip(row: np.ndarray, out: np.ndarray, last: int, shift: np.float32, wall: np.float32) -> None:
    """Hide the strip that ends at pixel `last`, left of a near surface that starts at `last + 1`."""
    near = row[last + 1]
    for u in range(last, -1, -1):
        width = shift * (near - row[u])
        distance = last + 1 - u
        if width < wall or distance > shift * near + 0.5:
            return
        if distance > width + 0.5:
            continue
        # A thing narrower than its own displacement lets the camera look past its other side.
        blocker = min(u + int(width + 0.5), len(row) - 1)
        if row[blocker] > row[u] + 0.5 * (near - row[u]):
            out[u] = _HIDDEN


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _average_cells(
    rgb: np.ndarray,
    disparity: np.ndarray,
    first: int,
    end: int,
    green: np.ndarray,
    sums: np.ndarray,
    near: np.ndarray,
    statistics: np.ndarray,
) -> None:
    """Average what decides about drop-outs over one row of squares of CELL_PX pixels, by every second pixel.

    Only horizontal contrast counts as texture: stereo matches along image rows, where a horizontal line tells nothing.

    Args:
        rgb: (H, W, 3) uint8.
        disparity: (H, W) float32.
        first, end: image rows.
        green: (samples + 1,) int32 scratch, samples = W / 2 rounded up.
        sums: (4, samples) int32 scratch.
        near: (samples,) float32 scratch.
        statistics: (4, w) float32, written: mean of the green channel (0-255), mean absolute difference of pixels two
            apart (0-255), share of saturated pixels, mean disparity of those that have one (0 if none has).
    """
    width, samples = disparity.shape[1], len(near)
    zero = np.float32(0.0)
    sums[:] = 0
    level, contrast, saturated, seen = sums[0], sums[1], sums[2], sums[3]
    cells, per_cell = statistics.shape[1], CELL_PX // 2
    statistics[3] = zero
    for v in range(first, end, 2):
        line, d = rgb[v], disparity[v]
        for i in range(samples):
            green[i] = line[2 * i, 1]
            near[i] = d[2 * i]
        green[samples] = line[width - 1, 1]
        ahead = green[1:]
        for i in range(samples):
            level[i] += green[i]
            contrast[i] += abs(green[i] - ahead[i])
            saturated[i] += np.int32(green[i] >= _GLARE)
            seen[i] += np.int32(near[i] > zero)
        for j in range(cells):
            for i in range(per_cell * j, min(per_cell * (j + 1), samples)):
                statistics[3, j] += near[i]
    rows = (end - first + 1) // 2
    for j in range(cells):
        begin, stop = per_cell * j, min(per_cell * (j + 1), samples)
        total, difference, bright, there = 0, 0, 0, 0
        for i in range(begin, stop):
            total += level[i]
            difference += contrast[i]
            bright += saturated[i]
            there += seen[i]
        count = rows * (stop - begin)
        statistics[0, j] = total / count
        statistics[1, j] = difference / count
        statistics[2, j] = bright / count
        statistics[3, j] = statistics[3, j] / max(there, 1)
