"""Compiled loops of the depth error model.

Everything here works on disparities d = f B / z in pixels of the depth imager, because that is what a stereo camera
measures: its noise is uniform there, a plane is an affine function of the image coordinates there, and a missing
reading is simply d = 0. Each function is one pass over the image; none draws random numbers, none keeps state, and
every pixel depends on its inputs alone, so that results do not depend on how the work is split.

Importing this module loads numba: do so when a frame is processed, not at the top of a module.
"""

from __future__ import annotations

import numpy as np

from stair_env.common.compiling import njit

CELL_PX = 8  # side of the squares that have probabilities of holes; as in `scene_kernels`
BAND_PX = 16  # rows that are worked on together
_HIDDEN = np.float32(0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def measure_rows(
    bands: np.ndarray,
    disparity: np.ndarray,
    measured: np.ndarray,
    exact_m: np.ndarray,
    reach: int,
    edges: tuple[np.float32, np.float32, np.float32, np.float32],
    focal_baseline: np.float32,
    noise_px: tuple[np.float32, np.float32, np.float32],
    quantum_px: np.float32,
    scale: np.float32,
    unit_m: np.float32,
    range_m: tuple[np.float32, np.float32],
    single: np.float32,
    false_patches: tuple[np.float32, np.float32, np.float32],
    corners: np.ndarray,
    normal: np.ndarray,
    broad: np.ndarray,
    uniform: np.ndarray,
    streaks: np.ndarray,
    white: np.ndarray,
    offsets: np.ndarray,
    unit_place: tuple[int, int],
    out: np.ndarray,
) -> None:
    """Edges, noise, quantisation, scale, range and holes: from disparity to the depth that is handed out.

    Args:
        bands: (k,) int64 which bands of BAND_PX rows to work on.
        disparity: (H, W) float32 of the scene.
        measured: (H, W) float32, the same after shadows and creases, 0 in shadows.
        exact_m: (H, W) float32, exact depth, kept where nothing changed the disparity; (0, 0) where there is noise,
            quantisation or a false patch.
        reach: half the matching window, image pixels; 0 leaves edges as they are.
        edges: jump, jitter, flying and fattened share, see `_blur_row`.
        focal_baseline: pixels times metres.
        noise_px: standard deviations of the disparity, depth-imager pixels: new in every frame, the same while the
            camera stands still, and the unit's own.
        quantum_px: step of the disparity, depth-imager pixels; 0 for none.
        scale: factor on depth.
        unit_m: step of the depth, metres; 0 for none.
        range_m: nearest and farthest reading that is kept.
        single: share of pixels that are lost one by one.
        false_patches: share of pixels in patches at a false distance, how much more of a lost band, factor on their
            disparity.
        corners: (2, h + 1, w + 1) float32 probability of a hole and of a lost band at the corners of the cells.
        normal, broad: (N, N + W) normal noise, as fine as a window, and far broader.
        uniform, streaks, white: (N, N + W + CELL_PX) uniform noise: blobs, long along the rows, uncorrelated.
        offsets: (k,) int64 places in the tables where this frame begins.
        unit_place: place in `broad` that belongs to the unit.
        out: (H, W) float32, written.
    """
    height, width = disparity.shape
    side = normal.shape[0]
    zero = np.float32(0.0)
    patched = (false_patches[0] > zero) | (false_patches[1] > zero)
    mark = np.zeros(-(-width // 8) * 8, np.uint8)
    row = np.empty(width, np.float32)
    chance, band_chance = np.empty(width + CELL_PX, np.float32), np.empty(width + CELL_PX, np.float32)
    for index in bands:
        for v in range(index * BAND_PX, min((index + 1) * BAND_PX, height)):
            hole = uniform[(v + offsets[10]) % side, offsets[11] :]
            band = streaks[(v + offsets[14]) % side, offsets[15] :]
            grain = white[(v + offsets[16]) % side, offsets[17] :]
            _interpolate_row(corners[0], v, chance)
            _interpolate_row(corners[1], v, band_chance)
            for u in range(width):
                row[u] = measured[v, u]
            if reach > 0:
                _blur_row(disparity, measured, v, reach, edges, normal, uniform, offsets, mark, row)
            if exact_m.shape[0] > 0:
                _exact_row(row, exact_m[v], focal_baseline, out[v])
            else:
                if patched:
                    patch = streaks[(v + offsets[18]) % side, offsets[19] :]
                    _patch_row(row, patch, band_chance, false_patches)
                noise = normal[(v + offsets[8]) % side, offsets[9] :]
                held = normal[(v + offsets[12]) % side, offsets[13] :]
                own = broad[(v + unit_place[0]) % side, unit_place[1] :]
                _noisy_row(row, noise, held, own, noise_px, focal_baseline, quantum_px, out[v])
            _limit_row(scale, unit_m, range_m, hole, chance, band, band_chance, grain, single, out[v])


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _blur_row(
    disparity: np.ndarray,
    measured: np.ndarray,
    v: int,
    reach: int,
    edges: tuple[np.float32, np.float32, np.float32, np.float32],
    normal: np.ndarray,
    uniform: np.ndarray,
    offsets: np.ndarray,
    mark: np.ndarray,
    out_row: np.ndarray,
) -> None:
    """Make edges in row v wander, those of shadows too, and mix near with far beside them.

    A matching window that straddles an edge returns either side or something in between. An edge is where the second
    difference of the measured disparity over `reach` pixels exceeds `jump`: zero on any plane, whatever its slant.

    Args:
        disparity: (H, W) float32 of the scene.
        measured: (H, W) float32, 0 in shadows.
        v: the row.
        reach: half the matching window, image pixels.
        edges: jump, the smallest second difference that counts as an edge, depth-imager pixels; jitter, the standard
            deviation of the edge's position, image pixels; share of edge pixels that become a mixture (shadows do not);
            share of edge pixels that take the near side: what stands before a plain wall grows by half a window,
            because its outline is all the texture there is.
        normal, uniform: (N, N + W) noise tables.
        offsets: (k,) int64 places in the tables where this frame begins.
        mark: (at least W,) uint8, a multiple of 8 long, scratch, zeros behind the row.
        out_row: (W,) float32, holds row v of measured and is changed in place.
    """
    height, width = disparity.shape
    side, one = normal.shape[0], np.float32(1.0)
    jump, jitter_px, flying_share, fattened_share = edges
    row = measured[v]
    above, below = measured[max(v - reach, 0)], measured[min(v + reach, height - 1)]
    if _mark_edges(row, above, below, reach, jump, mark):
        shift_u = normal[(v + offsets[0]) % side, offsets[1] :]
        shift_v = normal[(v + offsets[2]) % side, offsets[3] :]
        chance = uniform[(v + offsets[4]) % side, offsets[5] :]
        mixture = uniform[(v + offsets[6]) % side, offsets[7] :]
        marks_of_8 = mark.view(np.uint64)  # most of them are all zero, and cheaper to skip together
        for eighth in range(len(marks_of_8)):
            if marks_of_8[eighth] == 0:
                continue
            for u in range(8 * eighth, min(8 * eighth + 8, width)):
                if mark[u] == 0:
                    continue
                if chance[u] < flying_share and row[u] != _HIDDEN:
                    near, far = _extremes(disparity, v, u, reach)
                    out_row[u] = far + mixture[u] * (near - far)
                elif chance[u] > one - fattened_share and row[u] != _HIDDEN:
                    out_row[u] = _extremes(disparity, v, u, reach)[0]
                elif jitter_px > 0.0:
                    source_u = min(max(u + int(np.rint(jitter_px * shift_u[u])), 0), width - 1)
                    source_v = min(max(v + int(np.rint(jitter_px * shift_v[u])), 0), height - 1)
                    out_row[u] = measured[source_v, source_u]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _mark_edges(
    row: np.ndarray, above: np.ndarray, below: np.ndarray, reach: int, jump: np.float32, mark: np.ndarray
) -> bool:
    """Set mark to 1 where the second difference along or across the row exceeds jump; whether it does anywhere."""
    width = len(row)
    two = np.float32(2.0)
    for u in range(width):
        mark[u] = abs(above[u] + below[u] - two * row[u]) > jump
    # Slices, because an index that might be negative keeps the compiler from using vector instructions.
    span = max(width - 2 * reach, 0)
    left, middle, right, inner = row[:span], row[reach : reach + span], row[2 * reach :], mark[reach : reach + span]
    for u in range(span):
        inner[u] |= np.uint8(abs(left[u] + right[u] - two * middle[u]) > jump)
    marks = 0
    for u in range(width):
        marks += mark[u]
    return marks > 0


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _extremes(disparity: np.ndarray, v: int, u: int, reach: int) -> tuple[np.float32, np.float32]:
    """Largest and smallest disparity among a pixel and its four neighbours at distance reach."""
    height, width = disparity.shape
    left, right = disparity[v, max(u - reach, 0)], disparity[v, min(u + reach, width - 1)]
    up, down = disparity[max(v - reach, 0), u], disparity[min(v + reach, height - 1), u]
    here = disparity[v, u]
    return max(here, left, right, up, down), min(here, left, right, up, down)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _exact_row(measured: np.ndarray, depth_m: np.ndarray, focal_baseline: np.float32, out: np.ndarray) -> None:
    """Depth of noiseless disparities (W,); untouched ones keep their exact depth."""
    zero, one = np.float32(0.0), np.float32(1.0)
    for u in range(len(out)):
        d = measured[u]
        z = focal_baseline / (d if d > zero else one)
        z = depth_m[u] if d == focal_baseline / depth_m[u] else z
        out[u] = z if d > zero else zero


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _patch_row(
    measured: np.ndarray,
    patch: np.ndarray,
    band_chance: np.ndarray,
    false_patches: tuple[np.float32, np.float32, np.float32],
) -> None:
    """Move disparities (W,) within patches to a false distance, in place; these are not lost with a band."""
    share, share_in_bands, factor = false_patches
    zero = np.float32(0.0)
    for u in range(len(measured)):
        false = patch[u] < share + share_in_bands * band_chance[u]
        measured[u] = measured[u] * factor if false else measured[u]
        band_chance[u] = zero if false else band_chance[u]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _noisy_row(
    measured: np.ndarray,
    noise: np.ndarray,
    held: np.ndarray,
    own: np.ndarray,
    noise_px: tuple[np.float32, np.float32, np.float32],
    focal_baseline: np.float32,
    quantum_px: np.float32,
    out: np.ndarray,
) -> None:
    """Depth of disparities (W,) after noise and rounding."""
    zero, one, half = np.float32(0.0), np.float32(1.0), np.float32(0.5)
    per_quantum = one / quantum_px if quantum_px > zero else zero
    fresh_px, held_px, unit_px = noise_px
    for u in range(len(out)):
        d = measured[u] + (fresh_px * noise[u] + held_px * held[u] + unit_px * own[u])
        rounded = np.floor(d * per_quantum + half) * quantum_px
        d = rounded if quantum_px > zero else d
        seen = (measured[u] > zero) & (d > zero)
        z = focal_baseline / (d if seen else one)
        out[u] = z if seen else zero


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _limit_row(
    scale: np.float32,
    unit_m: np.float32,
    range_m: tuple[np.float32, np.float32],
    hole: np.ndarray,
    chance: np.ndarray,
    band: np.ndarray,
    band_chance: np.ndarray,
    grain: np.ndarray,
    single: np.float32,
    depth_m: np.ndarray,
) -> None:
    """Scale and round depths (W,) in place; drop what is out of range or falls into a hole."""
    zero, half = np.float32(0.0), np.float32(0.5)
    per_unit = np.float32(1.0) / unit_m if unit_m > zero else zero
    nearest_m, farthest_m = range_m
    for u in range(len(depth_m)):
        z = depth_m[u] * scale
        rounded = np.floor(z * per_unit + half) * unit_m
        z = rounded if unit_m > zero else z
        matched = (hole[u] >= chance[u]) & (band[u] >= band_chance[u]) & (grain[u] >= single)
        keep = (z >= nearest_m) & (z <= farthest_m) & matched
        depth_m[u] = z if keep else zero


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _interpolate_row(corners: np.ndarray, v: int, values: np.ndarray) -> None:
    """Bilinear interpolation of cell corners along image row v into values (W + CELL_PX,)."""
    upper = v // CELL_PX
    weight = np.float32((v % CELL_PX + 0.5) / CELL_PX)
    step = np.float32(1.0 / CELL_PX)
    half = np.float32(0.5)
    for j in range(corners.shape[1] - 1):
        left = corners[upper, j] + weight * (corners[upper + 1, j] - corners[upper, j])
        right = corners[upper, j + 1] + weight * (corners[upper + 1, j + 1] - corners[upper, j + 1])
        slope = (right - left) * step
        for i in range(CELL_PX):
            values[j * CELL_PX + i] = left + slope * (np.float32(i) + half)
