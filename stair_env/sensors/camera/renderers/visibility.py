"""Compiled primary visibility: which solid each pixel sees, and how far away it is.

The image is cut into tiles. A solid is tested against a tile's pixels only when the tile's bundle of rays can enter its
bounding box nearer than everything found so far.

Rays are given in the camera frame with z = 1, so that the ray parameter is the depth along the optical axis. Each
solid brings the rays into its own frame: direction m @ (rx, ry, 1), origin o. Only the point where a ray enters a solid
counts; a solid that contains the camera is not seen. The loops run over flat arrays and have no branches, which lets
LLVM vectorise them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stair_env.common.compiling import njit

BOX, SPHERE, CYLINDER, CAPSULE = 0, 1, 2, 3
TILE = 16  # pixels
AREA = TILE * TILE  # rays that fill the vector units and stay in the first-level cache
# No "nnan" and "ninf": a ray along a box face divides by zero on purpose.
FAST_MATH = {"contract", "reassoc", "nsz", "arcp"}

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_TINY = np.float32(1e-12)
_HUGE = np.float32(1e30)

# What only kernels call is compiled into its caller, inlined by LLVM, and has no cache of its own. As a function it
# would stand twice in a process that compiles (by itself, and as the caller's copy) and once in one that loads the
# caller from the cache; the linker takes the first it meets, and under these flags the two may round differently. So
# a machine has one code for a kernel, whatever it had compiled before, and one seed gives one picture.
part: Any = njit(nogil=True, error_model="numpy", fastmath=FAST_MATH, forceinline=True)
kernel: Any = njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST_MATH)


@part
def hit_box(depth, ids, rx, ry, m, o, size, near, index):  # type: ignore[no-untyped-def]
    """Enter an oriented box of half extents size; keeps the nearer of depth and the entry."""
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    a0, a1, a2 = -size[0] - o[0], -size[1] - o[1], -size[2] - o[2]
    b0, b1, b2 = size[0] - o[0], size[1] - o[1], size[2] - o[2]
    for k in range(depth.shape[0]):
        x, y, old = rx[k], ry[k], depth[k]
        i0 = _ONE / (m00 * x + m01 * y + m02)
        i1 = _ONE / (m10 * x + m11 * y + m12)
        i2 = _ONE / (m20 * x + m21 * y + m22)
        p0, q0, p1, q1, p2, q2 = a0 * i0, b0 * i0, a1 * i1, b1 * i1, a2 * i2, b2 * i2
        enter = p0 if p0 < q0 else q0
        leave = q0 if p0 < q0 else p0
        e1 = p1 if p1 < q1 else q1
        l1 = q1 if p1 < q1 else p1
        e2 = p2 if p2 < q2 else q2
        l2 = q2 if p2 < q2 else p2
        enter = e1 if e1 > enter else enter
        enter = e2 if e2 > enter else enter
        leave = l1 if l1 < leave else leave
        leave = l2 if l2 < leave else leave
        hit = (enter <= leave) & (enter > near) & (enter < old)
        depth[k] = enter if hit else old
        ids[k] = index if hit else ids[k]


@part
def hit_sphere(depth, ids, rx, ry, m, o, size, near, index):  # type: ignore[no-untyped-def]
    """Enter a sphere of radius size[0]."""
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    o0, o1, o2, r2 = o[0], o[1], o[2], size[0] * size[0]
    for k in range(depth.shape[0]):
        x, y, old = rx[k], ry[k], depth[k]
        d0 = m00 * x + m01 * y + m02
        d1 = m10 * x + m11 * y + m12
        d2 = m20 * x + m21 * y + m22
        inverse = _ONE / (d0 * d0 + d1 * d1 + d2 * d2)
        # From the point nearest to the centre, which loses less precision than the textbook discriminant.
        middle = -(o0 * d0 + o1 * d1 + o2 * d2) * inverse
        p0, p1, p2 = o0 + middle * d0, o1 + middle * d1, o2 + middle * d2
        inside = r2 - (p0 * p0 + p1 * p1 + p2 * p2)
        enter = middle - np.sqrt((inside if inside > _ZERO else _ZERO) * inverse)
        hit = (inside > _ZERO) & (enter > near) & (enter < old)
        depth[k] = enter if hit else old
        ids[k] = index if hit else ids[k]


@part
def hit_cylinder(depth, ids, rx, ry, m, o, size, near, index):  # type: ignore[no-untyped-def]
    """Enter a cylinder with flat ends, radius size[0], half length size[1]."""
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    o0, o1, r2 = o[0], o[1], size[0] * size[0]
    a, b = -size[1] - o[2], size[1] - o[2]
    for k in range(depth.shape[0]):
        x, y, old = rx[k], ry[k], depth[k]
        d0 = m00 * x + m01 * y + m02
        d1 = m10 * x + m11 * y + m12
        i2 = _ONE / (m20 * x + m21 * y + m22)
        inverse = _ONE / (d0 * d0 + d1 * d1 + _TINY)
        middle = -(o0 * d0 + o1 * d1) * inverse
        p0, p1 = o0 + middle * d0, o1 + middle * d1
        inside = r2 - (p0 * p0 + p1 * p1)
        half = np.sqrt((inside if inside > _ZERO else _ZERO) * inverse)
        enter, leave = middle - half, middle + half
        p, q = a * i2, b * i2
        e2 = p if p < q else q
        l2 = q if p < q else p
        enter = e2 if e2 > enter else enter
        leave = l2 if l2 < leave else leave
        hit = (inside > _ZERO) & (enter <= leave) & (enter > near) & (enter < old)
        depth[k] = enter if hit else old
        ids[k] = index if hit else ids[k]


@part
def hit_capsule(depth, ids, rx, ry, m, o, size, near, index):  # type: ignore[no-untyped-def]
    """Enter a capsule of radius size[0] whose straight part has half length size[1]."""
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    o0, o1, o2, r2, h = o[0], o[1], o[2], size[0] * size[0], size[1]
    for k in range(depth.shape[0]):
        x, y, old = rx[k], ry[k], depth[k]
        d0 = m00 * x + m01 * y + m02
        d1 = m10 * x + m11 * y + m12
        d2 = m20 * x + m21 * y + m22
        flat = d0 * d0 + d1 * d1 + _TINY
        inverse = _ONE / flat
        middle = -(o0 * d0 + o1 * d1) * inverse
        p0, p1 = o0 + middle * d0, o1 + middle * d1
        inside = r2 - (p0 * p0 + p1 * p1)
        side = middle - np.sqrt((inside if inside > _ZERO else _ZERO) * inverse)
        z = o2 + side * d2
        # Where a line enters the endless cylinder beyond an end, it can enter the capsule only through that ball.
        end = h if z > _ZERO else -h
        inverse = _ONE / (flat + d2 * d2)
        s2 = o2 - end
        ball_middle = -(o0 * d0 + o1 * d1 + s2 * d2) * inverse
        p0, p1, p2 = o0 + ball_middle * d0, o1 + ball_middle * d1, s2 + ball_middle * d2
        ball_inside = r2 - (p0 * p0 + p1 * p1 + p2 * p2)
        ball = ball_middle - np.sqrt((ball_inside if ball_inside > _ZERO else _ZERO) * inverse)
        straight = (z <= h) & (z >= -h)
        enter = side if straight else ball
        hit = (inside > _ZERO) & (straight | (ball_inside > _ZERO)) & (enter > near) & (enter < old)
        depth[k] = enter if hit else old
        ids[k] = index if hit else ids[k]


@kernel
def tile_spans(rx, ry):  # type: ignore[no-untyped-def]
    """Smallest and largest slopes in each tile.

    Args:
        rx, ry: (rows of tiles, columns of tiles, AREA) float32.

    Returns:
        (rows of tiles, columns of tiles, 4) float32: lowest and highest of rx, lowest and highest of ry.
    """
    spans = np.empty((rx.shape[0], rx.shape[1], 4), np.float32)
    for row in range(rx.shape[0]):
        for column in range(rx.shape[1]):
            x0, y0 = rx[row, column, 0], ry[row, column, 0]
            x1, y1 = x0, y0
            for k in range(AREA):
                x, y = rx[row, column, k], ry[row, column, k]
                x0, x1 = x if x < x0 else x0, x if x > x1 else x1
                y0, y1 = y if y < y0 else y0, y if y > y1 else y1
            spans[row, column, 0], spans[row, column, 1] = x0, x1
            spans[row, column, 2], spans[row, column, 3] = y0, y1
    return spans


@kernel
def to_camera(rotations, centres, camera_to_world):  # type: ignore[no-untyped-def]
    """Bring solids into the camera's view of them.

    Args:
        rotations: (n, 3, 3) float64 local to world.
        centres: (n, 3) float64.
        camera_to_world: (4, 4) float64.

    Returns:
        m (n, 9) float32, camera to local rotations, row by row; o (n, 3) float32, the camera in each local frame.
    """
    n = rotations.shape[0]
    m, o = np.empty((n, 9), np.float32), np.empty((n, 3), np.float32)
    for i in range(n):
        for a in range(3):
            offset = 0.0
            for k in range(3):
                offset += rotations[i, k, a] * (camera_to_world[k, 3] - centres[i, k])
            o[i, a] = offset
            for b in range(3):
                total = 0.0
                for k in range(3):
                    total += rotations[i, k, a] * camera_to_world[k, b]
                m[i, 3 * a + b] = total
    return m, o


@part
def bundle_entry(x0, x1, y0, y1, m, o, half, i):  # type: ignore[no-untyped-def]
    """Lower bound of the depth at which a bundle of rays enters the bounding box of solid i; huge when no ray can."""
    enter, leave = _ZERO, _HUGE
    for a in range(3):
        mx, my, mz = m[i, 3 * a], m[i, 3 * a + 1], m[i, 3 * a + 2]
        low = min(mx * x0, mx * x1) + min(my * y0, my * y1) + mz
        high = max(mx * x0, mx * x1) + max(my * y0, my * y1) + mz
        near_face, far_face = -half[i, a] - o[i, a], half[i, a] - o[i, a]
        if high < _ZERO:  # towards the negative side: mirror the axis
            low, high = -high, -low
            near_face, far_face = -far_face, -near_face
        elif low <= _ZERO:  # some rays may run along the axis' faces
            if near_face > _ZERO:
                enter = max(enter, near_face / max(high, _TINY))
            elif far_face < _ZERO:
                enter = max(enter, far_face / min(low, -_TINY))
            continue
        if far_face < _ZERO:
            return _HUGE
        enter = max(enter, near_face / high)
        leave = min(leave, far_face / max(low, _TINY))
    return enter if enter <= leave else _HUGE


@part
def _sort_by(keys, values, n):  # type: ignore[no-untyped-def]
    """Insertion sort of the first n entries, in place."""
    for i in range(1, n):
        key, value, j = keys[i], values[i], i - 1
        while j >= 0 and keys[j] > key:
            keys[j + 1], values[j + 1] = keys[j], values[j]
            j -= 1
        keys[j + 1], values[j + 1] = key, value


@part
def _hit(kind, depth, ids, rx, ry, m, o, size, near, index):  # type: ignore[no-untyped-def]
    if kind == BOX:
        hit_box(depth, ids, rx, ry, m, o, size, near, index)
    elif kind == SPHERE:
        hit_sphere(depth, ids, rx, ry, m, o, size, near, index)
    elif kind == CYLINDER:
        hit_cylinder(depth, ids, rx, ry, m, o, size, near, index)
    else:
        hit_capsule(depth, ids, rx, ry, m, o, size, near, index)


@part
def _entries(indices, count, x0, x1, y0, y1, m, o, bounds, far, entries, order):  # type: ignore[no-untyped-def]
    """List those of the first count solids in indices that a bundle of rays can enter, and where; returns how many."""
    found = 0
    for c in range(count):
        i = indices[c]
        entry = bundle_entry(x0, x1, y0, y1, m, o, bounds, i)
        if entry < far:
            entries[found], order[found] = entry, i
            found += 1
    return found


@njit(nogil=True, fastmath=True, forceinline=True)
def _maximum(values, scratch):  # type: ignore[no-untyped-def]
    """Largest of AREA values; eight at once, which is faster than waiting for one result after another."""
    part = AREA // 8
    for k in range(part):
        x0, x1, x2, x3 = values[k], values[part + k], values[2 * part + k], values[3 * part + k]
        x4, x5, x6, x7 = values[4 * part + k], values[5 * part + k], values[6 * part + k], values[7 * part + k]
        scratch[k] = max(max(max(x0, x1), max(x2, x3)), max(max(x4, x5), max(x6, x7)))
    for k in range(8):
        scratch[part + k] = max(max(scratch[k], scratch[8 + k]), max(scratch[16 + k], scratch[24 + k]))
    found = scratch[part]
    for k in range(part + 1, part + 8):
        found = max(found, scratch[k])
    return found


@kernel
def trace_rows(rows, rx, ry, spans, kinds, sizes, bounds, m, o, near, far, depth, ids):  # type: ignore[no-untyped-def]
    """Fill whole rows of tiles.

    Args:
        rows: (k,) int64 indices of the rows of tiles to fill.
        rx, ry: (rows of tiles, columns of tiles, AREA) float32 slopes of the rays, row by row within a tile; those
            of a tile should be close together. Tiles may reach beyond the image.
        spans: (rows of tiles, columns of tiles, 4) float32, as from `tile_spans`.
        kinds: (n,) int32; sizes: (n, 3) float32; bounds: (n, 3) float32 half extents of the local bounding boxes.
        m, o: as from `to_camera`.
        near, far: float32 metres.
        depth: (H, W) float32 out, 0 where nothing is hit.
        ids: (H, W) int32 out, -1 where nothing is hit.
    """
    height, width, n = depth.shape[0], depth.shape[1], kinds.shape[0]
    tile_depth, tile_ids = np.empty(AREA, np.float32), np.empty(AREA, np.int32)
    entries, order = np.empty(n, np.float32), np.empty(n, np.int64)
    every, in_row, scratch = np.arange(n), np.arange(n), np.empty(AREA // 2, np.float32)
    for row in rows:
        # What a whole row cannot see, none of its tiles can.
        x0, x1, y0, y1 = spans[row, 0, 0], spans[row, 0, 1], spans[row, 0, 2], spans[row, 0, 3]
        for column in range(1, spans.shape[1]):
            x0, x1 = min(x0, spans[row, column, 0]), max(x1, spans[row, column, 1])
            y0, y1 = min(y0, spans[row, column, 2]), max(y1, spans[row, column, 3])
        candidates = _entries(every, n, x0, x1, y0, y1, m, o, bounds, far, entries, in_row)
        for column in range(spans.shape[1]):
            x0, x1, y0, y1 = spans[row, column, 0], spans[row, column, 1], spans[row, column, 2], spans[row, column, 3]
            found = _entries(in_row, candidates, x0, x1, y0, y1, m, o, bounds, far, entries, order)
            _sort_by(entries, order, found)
            for k in range(AREA):
                tile_depth[k], tile_ids[k] = far, -1
            tile_x, tile_y, farthest = rx[row, column], ry[row, column], far
            for j in range(found):
                if entries[j] >= farthest:
                    break
                i = order[j]
                _hit(kinds[i], tile_depth, tile_ids, tile_x, tile_y, m[i], o[i], sizes[i], near, np.int32(i))
                farthest = _maximum(tile_depth, scratch)
            u0, columns = column * TILE, min(TILE, width - column * TILE)
            for v in range(min(TILE, height - row * TILE)):
                for u in range(columns):
                    index = tile_ids[v * TILE + u]
                    ids[row * TILE + v, u0 + u] = index
                    depth[row * TILE + v, u0 + u] = tile_depth[v * TILE + u] if index >= 0 else _ZERO
