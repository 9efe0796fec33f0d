"""The compiled part of `perception.geometry.lines`: least-squares clustering from the middle columns outwards.

Importing this module loads numba: do so when a frame is measured, not at the top of a module. Everything is in pixels
of the 512 x 512 image. The constants stand here because compiled code keeps the values it was compiled with.
"""

from __future__ import annotations

import numpy as np

from stair_env.common.compiling import njit

COLUMNS = 16
COLUMN_WIDTH_PX = 32.0
MIDDLE_PX = 256.0
START_GAP_PX = 2.0  # segments of one column that are farther apart start different lines; twins are merged later
START_SLOPE_GAP = 0.2  # segments whose slopes differ by more start different lines
JOIN_TOLERANCE_PX = 3.0  # vertical distance within which a segment lies on a line
JOIN_GROWTH = 0.03  # extra tolerance per pixel between the segment and the known part of the line
JOIN_LIMIT_PX = 6.0
PENCIL_PRIOR = 1000.0  # weight of the slope that its neighbours expect of a line: (1 px of jitter / 0.03)^2
PENCIL_STIFFNESS = 1000.0  # px^2: keeps few and close lines from being extrapolated
LONE_PRIOR = 100.0  # weight of the common slope where there are no neighbours to tell: (1 px / 0.1)^2
MAX_SLOPE = 3.0  # steeper than any stair line that a camera within 60 degrees of roll can see
MAX_ITERATIONS = 5


@njit(cache=True, nogil=True, error_model="numpy")
def cluster(
    ends: np.ndarray,
    column: np.ndarray,
    weight: np.ndarray,
    slope: np.ndarray,
    common_slope: float,
    label: np.ndarray,
    lines: np.ndarray,
) -> int:
    """Give every segment a line.

    Args:
        ends: (n, 4) x1, y1, x2, y2.
        column: (n,) grid column.
        weight: (n,).
        slope: (n,) of each segment, steadied where it is short.
        common_slope: of the image.
        label: (n,) index of the line; written.
        lines: (n, 4) k, b, least x, greatest x of each line; the first rows are written.

    Returns:
        How many lines there are.
    """
    label[:] = -1
    right = COLUMNS // 2
    chosen = np.nonzero((column == right - 1) | (column == right))[0]
    count = _start(ends, slope, chosen, MIDDLE_PX, 0, label)
    count = _refit(ends, weight, common_slope, label, lines, count)
    for step in range(1, right):
        before = count
        for side in (right - 1 - step, right + step):
            chosen = np.nonzero(column == side)[0]
            for i in range(len(chosen)):
                label[chosen[i]] = _nearest(ends, chosen[i], lines, before)
            rest = chosen[label[chosen] < 0]
            count = _start(ends, slope, rest, (side + 0.5) * COLUMN_WIDTH_PX, count, label)
        count = _refit(ends, weight, common_slope, label, lines, count)
    for _ in range(MAX_ITERATIONS):
        changed = False
        for i in range(len(label)):
            best = _nearest(ends, i, lines, count)
            if best >= 0 and best != label[i]:
                label[i] = best
                changed = True
        if not changed:
            break
        count = _refit(ends, weight, common_slope, label, lines, count)
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _start(ends: np.ndarray, slope: np.ndarray, chosen: np.ndarray, at_x: float, count: int, label: np.ndarray) -> int:
    """Group segments without a line by where they cross x = at_x, and by slope, since lines may cross there."""
    if len(chosen) == 0:
        return count
    height = np.empty(len(chosen))
    for i, segment in enumerate(chosen):
        x, y = (ends[segment, 0] + ends[segment, 2]) / 2.0, (ends[segment, 1] + ends[segment, 3]) / 2.0
        height[i] = y + slope[segment] * (at_x - x)
    order = np.argsort(height)
    first = 0
    for last in range(1, len(order) + 1):
        if last < len(order) and height[order[last]] - height[order[last - 1]] <= START_GAP_PX:
            continue
        group = chosen[order[first:last]]
        by_slope = np.argsort(slope[group])
        label[group[by_slope[0]]] = count
        for i in range(1, len(group)):
            if slope[group[by_slope[i]]] - slope[group[by_slope[i - 1]]] > START_SLOPE_GAP:
                count += 1
            label[group[by_slope[i]]] = count
        count += 1
        first = last
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(ends: np.ndarray, segment: int, lines: np.ndarray, count: int) -> int:
    """The line on which a segment lies, -1 for none; a line that crosses it is off at its ends."""
    x1, y1, x2, y2 = ends[segment, 0], ends[segment, 1], ends[segment, 2], ends[segment, 3]
    middle = (x1 + x2) / 2.0
    best, least = -1, 1.0
    for line in range(count):
        k, b = lines[line, 0], lines[line, 1]
        gap = max(lines[line, 2] - middle, middle - lines[line, 3], 0.0)
        tolerance = min(JOIN_TOLERANCE_PX + JOIN_GROWTH * gap, JOIN_LIMIT_PX)
        excess = (abs(k * x1 + b - y1) + abs(k * x2 + b - y2)) / (2.0 * tolerance)
        if excess <= least:
            best, least = line, excess
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def _refit(
    ends: np.ndarray, weight: np.ndarray, common_slope: float, label: np.ndarray, lines: np.ndarray, count: int
) -> int:
    """Least squares per line over the end points of its segments; lines without segments vanish."""
    total, mean_x, mean_y = np.zeros(count), np.zeros(count), np.zeros(count)
    for i in range(len(label)):
        line = label[i]
        if line >= 0:
            total[line] += 2.0 * weight[i]
            mean_x[line] += weight[i] * (ends[i, 0] + ends[i, 2])
            mean_y[line] += weight[i] * (ends[i, 1] + ends[i, 3])
    name = np.full(count, -1)
    kept = 0
    for line in range(count):
        if total[line] > 0.0:
            name[line] = kept
            mean_x[kept], mean_y[kept] = mean_x[line] / total[line], mean_y[line] / total[line]
            kept += 1
    spread, product = np.zeros(kept), np.zeros(kept)
    lines[:kept, 2], lines[:kept, 3] = np.inf, -np.inf
    for i in range(len(label)):
        if label[i] < 0:
            continue
        line = name[label[i]]
        label[i] = line
        for end in range(2):
            dx, dy = ends[i, 2 * end] - mean_x[line], ends[i, 2 * end + 1] - mean_y[line]
            spread[line] += weight[i] * dx * dx
            product[line] += weight[i] * dx * dy
            lines[line, 2] = min(lines[line, 2], ends[i, 2 * end])
            lines[line, 3] = max(lines[line, 3], ends[i, 2 * end])
    _expect_pencil(spread, product, mean_x, mean_y, common_slope, lines)
    for line in range(kept):
        lines[line, 0] = min(max(lines[line, 0], -MAX_SLOPE), MAX_SLOPE)
        lines[line, 1] = mean_y[line] - lines[line, 0] * mean_x[line]
    return kept


@njit(cache=True, nogil=True, error_model="numpy")
def _expect_pencil(
    spread: np.ndarray,
    product: np.ndarray,
    mean_x: np.ndarray,
    mean_y: np.ndarray,
    common_slope: float,
    lines: np.ndarray,
) -> None:
    """Write the slope of every line.

    Parallel lines in space meet in one point of the image: their slope is affine in the height at which they cross its
    middle. That serves as a prior, which only matters to lines of few segments, whose own slope is noise.
    """
    count = len(spread)
    weight, height, slope, long = 0.0, 0.0, 0.0, 0
    for line in range(count):
        if spread[line] > PENCIL_PRIOR:
            long += 1
            weight += spread[line]
            height += spread[line] * (mean_y[line] + common_slope * (MIDDLE_PX - mean_x[line]))
            slope += product[line]
    if long < 3:
        for line in range(count):
            lines[line, 0] = (product[line] + LONE_PRIOR * common_slope) / (spread[line] + LONE_PRIOR)
        return
    height, slope = height / weight, slope / weight
    together, alone = 0.0, PENCIL_STIFFNESS * weight / long
    for line in range(count):
        if spread[line] > PENCIL_PRIOR:
            dy = mean_y[line] + common_slope * (MIDDLE_PX - mean_x[line]) - height
            together += dy * (product[line] - slope * spread[line])
            alone += spread[line] * dy * dy
    for line in range(count):
        dy = mean_y[line] + common_slope * (MIDDLE_PX - mean_x[line]) - height
        expected = slope + together / alone * dy
        lines[line, 0] = (product[line] + PENCIL_PRIOR * expected) / (spread[line] + PENCIL_PRIOR)
