"""Compiled loops of the stereo sensor. Importing this module loads numba: do so when a frame is made."""

from __future__ import annotations

import numpy as np

from stair_env.common.compiling import njit

BAND_PX = 16  # rows that are worked on together


@njit(cache=True, nogil=True, error_model="numpy")
def light_from_projector(
    bands: np.ndarray,
    depth_m: np.ndarray,
    focal_px: float,
    cx: float,
    cy: float,
    projector_x_m: float,
    table_px: float,
    table_cx: float,
    table_cy: float,
    map_u: np.ndarray,
    map_v: np.ndarray,
    irradiance: np.ndarray,
) -> None:
    """Where each pixel lies in the projector's pattern, and how much of its light reaches the surface there.

    Args:
        bands: (k,) int64 which bands of BAND_PX rows to work on.
        depth_m: (H, W) float32 seen by the imager, metres, 0 = nothing.
        focal_px, cx, cy: of the imager, pixels.
        projector_x_m: of the projector in the imager's frame (x right), metres; its axes are the imager's.
        table_px: pixels of the pattern's table per unit of tangent.
        table_cx, table_cy: the table's middle, pixels.
        map_u, map_v: (H, W) float32, written: place in the table.
        irradiance: (H, W) float32, written: cosine of incidence over the distance squared, 1 / m^2.
    """
    height, width = depth_m.shape
    rows = np.empty((3, width + 2), np.float64)  # inverse depths of three rows, infinite where nothing is
    for band in bands:
        first, end = band * BAND_PX, min((band + 1) * BAND_PX, height)
        _invert(depth_m[max(first - 1, 0)], rows[(first - 1) % 3])
        _invert(depth_m[first], rows[first % 3])
        for v in range(first, end):
            _invert(depth_m[min(v + 1, height - 1)], rows[(v + 1) % 3])
            above, here, below = rows[(v - 1) % 3, 1:-1], rows[v % 3], rows[(v + 1) % 3, 1:-1]
            left, middle, right = here[:-2], here[1:-1], here[2:]
            row_m, row_u, row_v, row_light = depth_m[v], map_u[v], map_v[v], irradiance[v]
            b = (v + 0.5 - cy) / focal_px
            for u in range(width):  # without branches, which lets LLVM vectorise it
                z = row_m[u]
                there = z > 0.0
                w = middle[u] if there else 1.0
                # Inverse depth is affine on a plane, w = (n . ray) / d, so its gradient is the plane's normal.
                wu = _smaller_step(w, left[u], right[u]) * focal_px
                wv = _smaller_step(w, above[u], below[u]) * focal_px
                a = (u + 0.5 - cx) / focal_px
                nx, ny, nz = wu, wv, w - wu * a - wv * b
                px, py = a * z - projector_x_m, b * z
                squared = px * px + py * py + z * z
                cosine = abs(nx * px + ny * py + nz * z) / np.sqrt((nx * nx + ny * ny + nz * nz) * squared)
                row_u[u] = px * w * table_px + table_cx if there else -1.0
                row_v[u] = py * w * table_px + table_cy if there else -1.0
                row_light[u] = cosine / squared if there else 0.0


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _invert(depth_m: np.ndarray, inverse: np.ndarray) -> None:
    """Fill inverse[1:-1], (W,) float64, with 1 / depth, infinite where there is none; the border repeats."""
    inner = inverse[1:-1]
    for u in range(len(depth_m)):
        inner[u] = 1.0 / depth_m[u] if depth_m[u] > 0.0 else np.inf
    inverse[0], inverse[-1] = inverse[1], inverse[-2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _smaller_step(w: float, before: float, after: float) -> float:
    """The smaller of the steps of inverse depth to two neighbours, infinite where none is: the one on one surface."""
    back, ahead = w - before, after - w
    step = back if abs(back) < abs(ahead) else ahead
    return step if abs(step) < np.inf else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def to_depth(
    disparity: np.ndarray,
    focal_baseline: float,
    unit_m: float,
    nearest_m: float,
    farthest_m: float,
    depth_m: np.ndarray,
) -> None:
    """Depth in whole units from disparity, 0 where there is none or it is out of range.

    Args:
        disparity: (h, w) float32, pixels, 0 = no match.
        focal_baseline: focal length times baseline, pixels times metres.
        unit_m: step of the depth, metres.
        nearest_m, farthest_m: readings outside are dropped.
        depth_m: (h, w) float32, written.
    """
    height, width = disparity.shape
    for v in range(height):
        for u in range(width):
            d = disparity[v, u]
            z = focal_baseline / d if d > 0.0 else 0.0
            depth_m[v, u] = np.floor(z / unit_m + 0.5) * unit_m if nearest_m <= z <= farthest_m else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def align(depth_m: np.ndarray, source: np.ndarray, shift_x_m: float, target: np.ndarray, out: np.ndarray) -> None:
    """Draw each reading into another camera's image as the rectangle that its pixel covers there; the nearest wins.

    Args:
        depth_m: (h, w) float32, metres, 0 = no reading.
        source, target: (4,) float64 fx fy cx cy of the two cameras, whose axes are parallel.
        shift_x_m: of the source camera in the target's frame (x right), metres.
        out: (H, W) float32, written.
    """
    height, width = depth_m.shape
    rows, columns = out.shape
    out[:] = np.inf
    slopes = np.empty(width + 1, np.float64)
    for u in range(width + 1):
        slopes[u] = (u - source[2]) / source[0]
    for v in range(height):
        y0 = (v - source[3]) / source[1] * target[1] + target[3]
        y1 = (v + 1.0 - source[3]) / source[1] * target[1] + target[3]
        first_v, last_v = max(int(np.floor(y0)), 0), min(int(np.floor(y1)), rows - 1)
        if first_v > last_v:
            continue
        for u in range(width):
            z = depth_m[v, u]
            if not z > 0.0:
                continue
            parallax = shift_x_m / z
            x0 = (slopes[u] + parallax) * target[0] + target[2]
            x1 = (slopes[u + 1] + parallax) * target[0] + target[2]
            first_u, last_u = max(int(np.floor(x0)), 0), min(int(np.floor(x1)), columns - 1)
            for j in range(first_v, last_v + 1):
                for i in range(first_u, last_u + 1):
                    if z < out[j, i]:
                        out[j, i] = z
    for j in range(rows):
        for i in range(columns):
            if out[j, i] == np.inf:
                out[j, i] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def smooth_along(disparity: np.ndarray, alpha: float, delta: float) -> None:
    """One pass of the recursive edge-preserving filter along the first axis, forth and back, in place.

    Each reading becomes alpha times itself and the rest the one before, unless they differ by more than delta or one of
    them is missing (Gastal and Oliveira's domain transform as librealsense documents its spatial filter).

    Args:
        disparity: (n, m) float32, pixels, 0 = no reading.
        alpha: weight of the reading itself.
        delta: step that counts as an edge, pixels.
    """
    count, width = disparity.shape
    for i in range(1, count):
        for j in range(width):
            here, before = disparity[i, j], disparity[i - 1, j]
            if here > 0.0 and before > 0.0 and abs(here - before) < delta:
                disparity[i, j] = alpha * here + (1.0 - alpha) * before
    for i in range(count - 2, -1, -1):
        for j in range(width):
            here, before = disparity[i, j], disparity[i + 1, j]
            if here > 0.0 and before > 0.0 and abs(here - before) < delta:
                disparity[i, j] = alpha * here + (1.0 - alpha) * before


@njit(cache=True, nogil=True, error_model="numpy")
def fill_holes(disparity: np.ndarray, mode: int) -> None:
    """Fill missing readings in place, row by row from the left.

    Args:
        disparity: (h, w) float32, 0 = no reading.
        mode: 0 takes the reading to the left, 1 the farthest of the neighbours to the left and above, 2 the nearest.
    """
    height, width = disparity.shape
    for v in range(height):
        for u in range(1, width):
            if disparity[v, u] > 0.0:
                continue
            if mode == 0:
                disparity[v, u] = disparity[v, u - 1]
                continue
            best = np.float32(0.0)
            for dv in range(-1, 2):
                if 0 <= v + dv < height:
                    near = disparity[v + dv, u - 1]
                    if near > 0.0 and (best == 0.0 or (near < best) == (mode == 1)):
                        best = near
            above = disparity[v - 1, u] if v > 0 else np.float32(0.0)
            if above > 0.0 and (best == 0.0 or (above < best) == (mode == 1)):
                best = above
            disparity[v, u] = best
