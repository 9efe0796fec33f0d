"""Compiled loops of `perception.geometry.strips.strip_planes` and `perception.geometry.strips.strip_labels`.

Importing this module loads numba: do so when a frame is measured, not at the top of a module. Arrays are float64, K
strips of N points; coordinates are (f, l, h) as in `perception.geometry.strips.strip_planes`.
"""

from __future__ import annotations

import numpy as np

from stair_env.common.compiling import njit

TREAD, RISER = 1, 2
SCATTER_FLOOR = 0.2  # added to the median residual: exact depth must not divide by zero
LOCATION_ROUNDS = 3


@njit(cache=True, nogil=True, error_model="numpy")
def explain(
    rays: np.ndarray,
    depth_m: np.ndarray,
    ok: np.ndarray,
    points_per_reading: np.ndarray,
    rotation: np.ndarray,
    sigma_per_m2: float,
    sigma_floor_m: float,
    cut: float,
    rows_per_column: int,
    answer: np.ndarray,
) -> None:
    """Fit every strip as a tread and as a riser: robust location of coordinate = ray coordinate * depth.

    What a reading is expected to scatter, and where it is taken to lie, follows from the fitted plane and not from
    the reading itself: noise that moves a point along its ray would otherwise tilt and shift every plane.

    Args:
        rays: (K, N, 3) camera frame, z = 1.
        depth_m: (K, N).
        ok: (K, N) bool.
        points_per_reading: (K,).
        rotation: (3, 3) camera to (f, l, h).
        sigma_per_m2, sigma_floor_m: standard deviation of depth, and floor of that of a coordinate, metres.
        cut: residual from which a point has no weight, standard deviations.
        rows_per_column: consecutive points that lie in one image column, upper one first.
        answer: (2, K, 4) for tread and riser: value, standard deviation, scatter, share of inliers; written.
    """
    strips, points = depth_m.shape
    per_depth = np.empty(points)
    measured = np.empty(points)
    upper = np.empty(points, np.bool_)
    scratch = np.empty(points)
    for strip in range(strips):
        for kind in range(2):
            axis = 2 if kind == 0 else 0
            r0, r1, r2 = rotation[axis, 0], rotation[axis, 1], rotation[axis, 2]
            count = 0
            for i in range(points):
                if ok[strip, i]:
                    per_depth[count] = r0 * rays[strip, i, 0] + r1 * rays[strip, i, 1] + r2 * rays[strip, i, 2]
                    measured[count] = depth_m[strip, i]
                    upper[count] = i % rows_per_column < rows_per_column // 2
                    scratch[count] = per_depth[count] * measured[count]
                    count += 1
            if count == 0:
                answer[kind, strip, 0] = 0.0
                answer[kind, strip, 1] = 1e3
                answer[kind, strip, 2] = SCATTER_FLOOR
                answer[kind, strip, 3] = 0.0
                continue
            value = _median(scratch, count)
            total = 0.0
            for _ in range(LOCATION_ROUNDS):
                total, shift = 0.0, 0.0
                for i in range(count):
                    sigma = _sigma(value, per_depth[i], measured[i], sigma_per_m2, sigma_floor_m)
                    residual = per_depth[i] * measured[i] - value
                    weight = _weight(residual / sigma, cut) / (sigma * sigma)
                    total += weight
                    shift += weight * residual
                if total > 0.0:
                    value += shift / total
            fits_upper, fits_lower, all_upper, all_lower = 0, 0, 0, 0
            for i in range(count):
                sigma = _sigma(value, per_depth[i], measured[i], sigma_per_m2, sigma_floor_m)
                chi = abs(per_depth[i] * measured[i] - value) / sigma
                scratch[i] = chi
                if upper[i]:
                    all_upper += 1
                    fits_upper += chi < cut
                else:
                    all_lower += 1
                    fits_lower += chi < cut
            if strip == 0 or strip == strips - 1:  # they may end in something else
                share = (fits_upper + fits_lower) / count
            else:
                share = min(fits_upper / max(all_upper, 1), fits_lower / max(all_lower, 1))
            answer[kind, strip, 0] = value
            answer[kind, strip, 1] = 1.0 / np.sqrt(max(total / points_per_reading[strip], 1e-6))
            answer[kind, strip, 2] = _median(scratch, count) + SCATTER_FLOOR
            answer[kind, strip, 3] = share


@njit(cache=True, nogil=True, error_model="numpy")
def cheapest_sequence(unary: np.ndarray, pair: np.ndarray, kinds: np.ndarray) -> None:
    """The kinds whose costs sum to the least (Viterbi).

    Args:
        unary: (K, 3) cost of each kind of each strip.
        pair: (K - 1, 3, 3) cost of the near strip's kind and the far one's.
        kinds: (K,) int64; written. Among equals the lower number wins.
    """
    count = len(unary)
    came_from = np.zeros((count, 3), np.int64)
    best = unary[0].copy()
    through = np.empty(3)
    for strip in range(1, count):
        for far in range(3):
            origin = 0
            for near in range(1, 3):
                if best[near] + pair[strip - 1, near, far] < best[origin] + pair[strip - 1, origin, far]:
                    origin = near
            came_from[strip, far] = origin
            through[far] = best[origin] + pair[strip - 1, origin, far] + unary[strip, far]
        best[:] = through
    kinds[-1] = np.argmin(best)
    for strip in range(count - 1, 0, -1):
        kinds[strip - 1] = came_from[strip, kinds[strip]]


@njit(cache=True, nogil=True, error_model="numpy")
def _median(values: np.ndarray, count: int) -> float:
    """Lower median of the first `count` values."""
    middle = (count - 1) // 2
    return np.partition(values[:count], middle)[middle]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _plane_depth(value: float, per_depth: float, measured: float) -> float:
    """Depth at which a ray meets the plane; the reading itself where that is nowhere near it."""
    depth = value / per_depth if abs(per_depth) >= 1e-3 else value / 1e-3
    return depth if 0.5 * measured < depth < 2.0 * measured else measured


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sigma(value: float, per_depth: float, measured: float, sigma_per_m2: float, sigma_floor_m: float) -> float:
    """Standard deviation that the coordinate of a point on the plane would have."""
    depth = _plane_depth(value, per_depth, measured)
    along = sigma_per_m2 * depth * depth * per_depth
    return np.sqrt(along * along + sigma_floor_m * sigma_floor_m)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _weight(chi: float, cut: float) -> float:
    """Tukey's biweight."""
    share = chi / cut
    return (1.0 - share * share) ** 2 if abs(share) < 1.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations(
    rays: np.ndarray,
    depth_m: np.ndarray,
    ok: np.ndarray,
    points_per_reading: np.ndarray,
    rotation: np.ndarray,
    sigma_per_m2: float,
    sigma_floor_m: float,
    cut: float,
    kind: np.ndarray,
    value: np.ndarray,
    normal: np.ndarray,
    gradient: np.ndarray,
) -> None:
    """Add what a face's points say about a small rotation about (f, l, h); each face's value is eliminated.

    A rotation w moves p to p + w x p: h gains w_f l - w_l f, and f gains w_l h - w_h l.

    Args:
        rays, depth_m, ok, points_per_reading, rotation, sigma_per_m2, sigma_floor_m, cut: as in `explain`.
        kind, value: (K,) what each strip is; unknown ones say nothing.
        normal: (K, 3, 3), added to.
        gradient: (K, 3), added to.
    """
    strips, points = depth_m.shape
    jacobian = np.empty((points, 3))
    residuals = np.empty(points)
    weights = np.empty(points)
    for strip in range(strips):
        if kind[strip] == 0:
            continue
        axis = 2 if kind[strip] == TREAD else 0
        total, mean_residual = 0.0, 0.0
        mean = np.zeros(3)
        count = 0
        for i in range(points):
            if not ok[strip, i]:
                continue
            x, y, z = rays[strip, i, 0], rays[strip, i, 1], rays[strip, i, 2]
            f = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z
            left = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z
            h = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z
            per_depth = h if axis == 2 else f
            measured = depth_m[strip, i]
            sigma = _sigma(value[strip], per_depth, measured, sigma_per_m2, sigma_floor_m)
            residual = per_depth * measured - value[strip]
            weight = _weight(residual / sigma, cut) / (sigma * sigma * points_per_reading[strip])
            if weight <= 0.0:
                continue
            depth = _plane_depth(value[strip], per_depth, measured)
            if axis == 2:
                jacobian[count, 0], jacobian[count, 1], jacobian[count, 2] = left * depth, -f * depth, 0.0
            else:
                jacobian[count, 0], jacobian[count, 1], jacobian[count, 2] = 0.0, h * depth, -left * depth
            residuals[count], weights[count] = residual, weight
            total += weight
            mean_residual += weight * residual
            for k in range(3):
                mean[k] += weight * jacobian[count, k]
            count += 1
        if total <= 0.0:
            continue
        mean_residual /= total
        for k in range(3):
            mean[k] /= total
        for i in range(count):
            for k in range(3):
                a = weights[i] * (jacobian[i, k] - mean[k])
                gradient[strip, k] += a * (residuals[i] - mean_residual)
                for m in range(3):
                    normal[strip, k, m] += a * (jacobian[i, m] - mean[m])
