"""Compiled loops of `perception.geometry.profile.depth_profile`.

Importing this module loads numba: do so when a frame is measured, not at the top of a module.
"""

from __future__ import annotations

import numpy as np

from stair_env.common.compiling import njit

UNKNOWN, TREAD, RISER = 0, 1, 2


@njit(cache=True, nogil=True, error_model="numpy")
def scan(
    depth_m: np.ndarray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    rotation: np.ndarray,
    slopes: np.ndarray,
    columns: np.ndarray,
    left_range: tuple[float, float],
    depth_range: tuple[float, float],
    min_readings: int,
    forward: np.ndarray,
    height: np.ndarray,
    distance: np.ndarray,
    readings: np.ndarray,
) -> None:
    """Median place of what is seen under each slope, over all columns.

    All points of the line in which a staircase is cut by a plane through the camera that contains the stairs' lateral
    axis are equally far and equally high, so that one picture row of the cross-section is the median along that line.

    Args:
        depth_m: (H, W), 0 = no reading.
        fx, fy, cx, cy: pinhole model, pixels.
        rotation: (3, 3) camera to (f, l, h).
        slopes: (J,) h / f of each row of the cross-section.
        columns: (C,) image columns.
        left_range: least and greatest l that belongs to the staircase, metres.
        depth_range: least and greatest depth that counts, metres.
        min_readings: rows with fewer hold nothing.
        forward, height, distance: (J,) median f, and h and depth that go with it; 0 where there is nothing; written.
        readings: (J,) int64, how many readings; written.
    """
    rows, width = depth_m.shape
    count_columns = len(columns)
    all_f = np.empty(count_columns)
    for j in range(len(slopes)):
        a0 = rotation[2, 0] - slopes[j] * rotation[0, 0]
        a1 = rotation[2, 1] - slopes[j] * rotation[0, 1]
        a2 = rotation[2, 2] - slopes[j] * rotation[0, 2]
        forward[j], height[j], distance[j], readings[j] = 0.0, 0.0, 0.0, 0
        if abs(a1) < 1e-6:
            continue
        count, slope_sum, ahead_sum = 0, 0.0, 0.0
        for c in range(count_columns):
            u = columns[c]
            x = (u + 0.5 - cx) / fx
            v_exact = -(a0 * x + a2) / a1 * fy + cy
            if not 0.0 <= v_exact < rows or not 0 <= u < width:
                continue
            v = int(v_exact)
            z = depth_m[v, u]
            if not depth_range[0] < z < depth_range[1]:
                continue
            y = (v + 0.5 - cy) / fy
            left = z * (rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2])
            if not left_range[0] < left < left_range[1]:
                continue
            ahead = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2]
            if ahead <= 1e-3:
                continue
            all_f[count] = z * ahead
            slope_sum += (rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]) / ahead  # of the pixel's centre
            ahead_sum += ahead
            count += 1
        if count >= min_readings:
            middle = count // 2
            readings[j] = count
            forward[j] = np.partition(all_f[:count], middle)[middle]
            height[j] = forward[j] * slope_sum / count
            distance[j] = forward[j] * count / ahead_sum


@njit(cache=True, nogil=True, error_model="numpy")
def segment(
    forward: np.ndarray,
    height: np.ndarray,
    forward_std: np.ndarray,
    height_std: np.ndarray,
    readings: np.ndarray,
    rows_per_reading: float,
    face_cost: float,
    unknown_cost: float,
    first: np.ndarray,
    kind: np.ndarray,
) -> tuple[int, float]:
    """Cut the cross-section into treads, risers and unknown parts: the cheapest cut, by dynamic programming.

    Args:
        forward, height: (J,) the cross-section, nearest row first.
        forward_std, height_std: (J,) of them.
        readings: (J,) 0 where a row holds nothing.
        rows_per_reading: neighbouring rows that together say as much as one independent reading.
        face_cost: of one more face, in squared standard deviations.
        unknown_cost: per row that is left unexplained, the same.
        first: (J,) first row of each part; the first entries are written.
        kind: (J,) UNKNOWN, TREAD or RISER of each part; the first entries are written.

    Returns:
        How many parts there are, and what the cut costs.
    """
    rows = len(forward)
    sums = np.zeros((2, 3, rows + 1))
    known = np.zeros(rows + 1)
    for j in range(rows):
        for axis in range(2):
            value = height[j] if axis == 0 else forward[j]
            std = height_std[j] if axis == 0 else forward_std[j]
            weight = 1.0 / (std * std * rows_per_reading) if readings[j] > 0 else 0.0
            sums[axis, 0, j + 1] = sums[axis, 0, j] + weight
            sums[axis, 1, j + 1] = sums[axis, 1, j] + weight * value
            sums[axis, 2, j + 1] = sums[axis, 2, j] + weight * value * value
        known[j + 1] = known[j] + (1.0 if readings[j] > 0 else 0.0)
    best, start, chosen = np.zeros(rows + 1), np.zeros(rows + 1, np.int64), np.zeros(rows + 1, np.int64)
    for end in range(1, rows + 1):
        best[end] = np.inf
        for begin in range(end):
            cost = best[begin] + unknown_cost * (known[end] - known[begin])
            choice = 0
            for axis in range(2):
                weight = sums[axis, 0, end] - sums[axis, 0, begin]
                if weight <= 0.0:
                    continue
                total = sums[axis, 1, end] - sums[axis, 1, begin]
                misfit = max(sums[axis, 2, end] - sums[axis, 2, begin] - total * total / weight, 0.0)
                if best[begin] + face_cost + misfit < cost:
                    cost, choice = best[begin] + face_cost + misfit, axis + 1
            if cost < best[end]:
                best[end], start[end], chosen[end] = cost, begin, choice
    count, end = 0, rows
    while end > 0:
        first[count], kind[count] = start[end], chosen[end]
        count, end = count + 1, start[end]
    first[:count] = first[:count][::-1].copy()
    kind[:count] = kind[:count][::-1].copy()
    return count, best[rows]


@njit(cache=True, nogil=True, error_model="numpy")
def line_distances(
    lines: np.ndarray,
    depth_m: np.ndarray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    toward: np.ndarray,
    samples: int,
    offset_px: float,
    distance: np.ndarray,
) -> None:
    """How far away image lines are: median over samples right above and right below them.

    Args:
        lines: (m, 8) rows of `perception.geometry.lines.LINE_FIELDS`.
        depth_m: (H, W), 0 = no reading.
        fx, fy, cx, cy: pinhole model, pixels.
        toward: (3,) unit vector, camera frame, along which distance counts.
        samples: along each line.
        offset_px: of the samples from the line.
        distance: (m,) metres, 0 where depth shows nothing; written.
    """
    rows, width = depth_m.shape
    found = np.empty(2 * samples)
    for i in range(len(lines)):
        count = 0
        for j in range(samples):
            x = lines[i, 0] + (lines[i, 2] - lines[i, 0]) * (j + 0.5) / samples
            y = lines[i, 4] * x + lines[i, 5]
            u = min(max(int(x), 0), width - 1)
            for side in (-offset_px, offset_px):
                v = int(y + side)
                if not 0 <= v < rows:
                    continue
                z = depth_m[v, u]
                if z > 0.0:
                    ray = toward[0] * (u + 0.5 - cx) / fx + toward[1] * (v + 0.5 - cy) / fy + toward[2]
                    found[count] = z * ray
                    count += 1
        distance[i] = np.partition(found[:count], count // 2)[count // 2] if count > 0 else 0.0
