"""Compiled shading: what colour each pixel has, from the depth and the solid it sees.

Works tile by tile in stages, each a loop over the tile's pixels without branches, so that LLVM vectorises it. The
pixels' values lie in one flat buffer of floats and one of integers, a block of AREA entries for each quantity: with
offsets known at compile time LLVM sees that the blocks do not overlap.

All of it is in one file because numba's cache of a compiled function watches only the file of that function: a change
in a module that it calls would go unnoticed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stair_env.common.compiling import njit

TILE = 16  # pixels, as in `visibility`, so that a row of tiles needs no other row's depth
AREA = TILE * TILE
BOX, SPHERE, CYLINDER, CAPSULE = 0, 1, 2, 3
MIP_SIDE = 256  # texels along the side of a texture's finest level
MIP_LEVELS = 9
MIP_TEXELS = sum((MIP_SIDE >> level) ** 2 for level in range(MIP_LEVELS))

# Blocks of the float buffer.
RX, RY, T = 0 * AREA, 1 * AREA, 2 * AREA  # slopes of the ray, depth
PX, PY, PZ = 3 * AREA, 4 * AREA, 5 * AREA  # point in the world
NX, NY, NZ = 6 * AREA, 7 * AREA, 8 * AREA  # normal in the world
U, V = 9 * AREA, 10 * AREA  # coordinates on the surface, metres
LIT, OPEN = 11 * AREA, 12 * AREA  # share of direct and of ambient light that arrives
DX, DY, DZ = 13 * AREA, 14 * AREA, 15 * AREA  # towards the light; as long as the way to a lamp
RED, GREEN, BLUE = 16 * AREA, 17 * AREA, 18 * AREA  # albedo, then encoded colour
DENSITY, STRENGTH, SHININESS = 19 * AREA, 20 * AREA, 21 * AREA  # of the look: texels per metre, gloss
GAIN = 22 * AREA  # of the look, three blocks
ACROSS, DOWN = 25 * AREA, 26 * AREA  # place between four texels, 0 to 1
SCRATCH = 27 * AREA  # two blocks
NUM_FLOATS = 29 * AREA
# Blocks of the integer buffer.
ID, FACE, BASE = 0 * AREA, 1 * AREA, 2 * AREA  # solid, its face, first texel of the look's texture
TEXELS = 3 * AREA  # indices of four texels, then the texels themselves
NUM_INTS = 7 * AREA

# Entries of a look, see `stair_env.sensors.camera.renderers.shading_tables`.
LOOK_DENSITY, LOOK_STRENGTH, LOOK_SHININESS, LOOK_GAIN = 0, 1, 2, 3
NUM_LOOK = 6
# Entries of the vector of light settings; see `stair_env.sensors.camera.renderers.shading_tables`.
LIGHT, LAMP, COLOUR, AMBIENT, EXPOSURE, GLOSS, HORIZON, ZENITH, SHADOWS = 0, 3, 4, 7, 10, 11, 12, 15, 18
TILT, CORNER, GRIME = 19, 22, 23
# A pattern's strength, cosine and sine of its angle, then pairs: bars a metre, share in shade, phase; sharpness, warp.
PATTERN, NUM_PATTERN = 24, 11
# A lane's gain, middle and inverse half width; patches: strength, two a metre, two phases, threshold, wetness.
SOIL, NUM_SOIL = 35, 10
NUM_SETTINGS = 45

_ZERO, _ONE, _TWO, _HALF = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(0.5)
_FOUR_FACES, _LIT_OR_NOT, _NO_REGION = np.int32(4), np.int32(2), np.int32(-1)
_BYTE, _TWO_BYTES, _LOWEST_BYTE = np.int32(8), np.int32(16), np.int32(255)
_EIGHTH = AREA // 8
_TINY = np.float32(1e-9)
_HUGE = np.float32(1e30)
_FACES_UP = np.float32(0.7)  # cosine of the steepest face that counts as a tread
_LIFT_M = np.float32(1e-3)  # shadow rays start this far above the surface
_OPEN_REACH_M = np.float32(0.12)  # how far from an inner edge ambient light is blocked
_OPEN_LOSS = np.float32(0.5)  # of ambient light in the inner edge itself: half of the hemisphere is wall
_AMBIENT_MEAN = np.float32(0.78)  # of faces at right angles to where most ambient light comes from
_PATTERN_DROP_M = np.float32(2.5)  # below a lamp a pattern's periods hold at this depth
_STEEPEST = np.float32(0.1)  # cosine from the vertical beyond which a lamp's pattern grows no coarser
_PATCH_EDGE = np.float32(6.0)  # how steeply a patch sets in
# Least-squares fit of 255 sRGB(x) over 0.0031308..1 by x and its 2nd, 4th and 8th root; errs by 0.02 levels at most.
_CURVE_1, _CURVE_2 = np.float32(-4.67033), np.float32(164.28962)
_CURVE_4, _CURVE_8 = np.float32(181.07308), np.float32(-85.69578)
_COARSER_FROM = np.float32(1.4)  # texels a pixel, from which on a coarser level is sharp enough
_MANTISSA_BITS, _CODE_OF_0 = np.int32(23), np.int32(127)  # of float32: bits below the exponent, code of exponent 0
_COARSER_CODE = _COARSER_FROM.view(np.int32) - np.int32((1 << 23) - 1)
_NO_DOUBLING, _COARSEST = np.int32(0), np.int32(MIP_LEVELS - 1)
_MIN_COSINE = np.float32(0.05)  # of the angle at which a texture is seen, below which it is not blurred further
_FINER_TEXELS = np.float32(4.0 / 3.0 * MIP_SIDE**2)
_LOBE_PEAK = np.float32(0.04)
_BELOW_HORIZON = np.float32(0.6)  # brightness of the ground beyond the floor's end relative to the sky above it
_KNEE = np.float32(0.75)  # radiance above which the film's shoulder begins

part: Any = njit(nogil=True, error_model="numpy", fastmath=True, forceinline=True)  # see `visibility.part`
kernel: Any = njit(cache=True, nogil=True, error_model="numpy", fastmath=True)


@part
def _points(f, pose):  # type: ignore[no-untyped-def]
    """World points from rays and depth; pose is camera_to_world as (12,) float32, row by row."""
    for k in range(AREA):
        x, y, t = f[RX + k], f[RY + k], f[T + k]
        f[PX + k] = (pose[0] * x + pose[1] * y + pose[2]) * t + pose[3]
        f[PY + k] = (pose[4] * x + pose[5] * y + pose[6]) * t + pose[7]
        f[PZ + k] = (pose[8] * x + pose[9] * y + pose[10]) * t + pose[11]


@part
def _box_surface(f, n, m, o, size, rotation, shift, index):  # type: ignore[no-untyped-def]
    """Normals and surface coordinates of the pixels that see box number index."""
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    r00, r01, r02, r10, r11, r12 = rotation[0], rotation[1], rotation[2], rotation[3], rotation[4], rotation[5]
    r20, r21, r22 = rotation[6], rotation[7], rotation[8]
    o0, o1, o2, h0, h1, h2 = o[0], o[1], o[2], size[0], size[1], size[2]
    s0, s1, s2 = shift[0], shift[1], shift[2]
    x_is_long = h0 > h1
    for k in range(AREA):
        x, y, t = f[RX + k], f[RY + k], f[T + k]
        p0 = (m00 * x + m01 * y + m02) * t + o0
        p1 = (m10 * x + m11 * y + m12) * t + o1
        p2 = (m20 * x + m21 * y + m22) * t + o2
        e0, e1, e2 = h0 - abs(p0), h1 - abs(p1), h2 - abs(p2)
        on0 = (e0 <= e1) & (e0 <= e2)
        on1 = (e1 <= e2) & (e1 < e0)
        along = p0 if on0 else (p1 if on1 else p2)
        sign = _ONE if along > _ZERO else -_ONE
        nz = sign * (r20 if on0 else (r21 if on1 else r22))
        q0, q1, q2 = p0 + s0, p1 + s1, p2 + s2
        mine = n[ID + k] == index
        n[FACE + k] = (0 if on0 else (1 if on1 else 2)) if mine else n[FACE + k]
        f[NX + k] = sign * (r00 if on0 else (r01 if on1 else r02)) if mine else f[NX + k]
        f[NY + k] = sign * (r10 if on0 else (r11 if on1 else r12)) if mine else f[NY + k]
        f[NZ + k] = nz if mine else f[NZ + k]
        u = q1 if on0 else (q0 if (on1 | x_is_long) else q1)
        v = q2 if (on0 | on1) else (q1 if x_is_long else q0)
        f[U + k] = u if mine else f[U + k]
        f[V + k] = v if mine else f[V + k]


@part
def _round_surface(f, n, m, o, size, rotation, kind, index):  # type: ignore[no-untyped-def]
    """The same for a sphere, cylinder or capsule."""
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    r00, r01, r02, r10, r11, r12 = rotation[0], rotation[1], rotation[2], rotation[3], rotation[4], rotation[5]
    r20, r21, r22 = rotation[6], rotation[7], rotation[8]
    o0, o1, o2, radius, half = o[0], o[1], o[2], size[0], size[1]
    flat_ends = kind == CYLINDER
    for k in range(AREA):
        x, y, t = f[RX + k], f[RY + k], f[T + k]
        p0 = (m00 * x + m01 * y + m02) * t + o0
        p1 = (m10 * x + m11 * y + m12) * t + o1
        p2 = (m20 * x + m21 * y + m22) * t + o2
        end = flat_ends & (half - abs(p2) < radius - np.sqrt(p0 * p0 + p1 * p1))
        axis_z = min(max(p2, -half), half)
        n0, n1, n2 = _ZERO if end else p0, _ZERO if end else p1, p2 if end else p2 - axis_z
        scale = _ONE / np.sqrt(n0 * n0 + n1 * n1 + n2 * n2 + _TINY)
        n0, n1, n2 = n0 * scale, n1 * scale, n2 * scale
        mine = n[ID + k] == index
        n[FACE + k] = 3 if mine else n[FACE + k]
        f[NX + k] = r00 * n0 + r01 * n1 + r02 * n2 if mine else f[NX + k]
        f[NY + k] = r10 * n0 + r11 * n1 + r12 * n2 if mine else f[NY + k]
        f[NZ + k] = r20 * n0 + r21 * n1 + r22 * n2 if mine else f[NZ + k]
        f[U + k] = p2 if mine else f[U + k]
        f[V + k] = np.float32(1.6) * radius * p1 / (abs(p0) + abs(p1) + _TINY) if mine else f[V + k]


@part
def _apply_look(f, n, up_base, up, side_base, side, index):  # type: ignore[no-untyped-def]
    """Spread the two looks of solid number index, each (NUM_LOOK,), over its pixels."""
    a0, a1, a2, a3, a4, a5 = up[0], up[1], up[2], up[3], up[4], up[5]
    b0, b1, b2, b3, b4, b5 = side[0], side[1], side[2], side[3], side[4], side[5]
    for k in range(AREA):
        mine, faces_up = n[ID + k] == index, f[NZ + k] > _FACES_UP
        n[BASE + k] = (up_base if faces_up else side_base) if mine else n[BASE + k]
        f[DENSITY + k] = (a0 if faces_up else b0) if mine else f[DENSITY + k]
        f[STRENGTH + k] = (a1 if faces_up else b1) if mine else f[STRENGTH + k]
        f[SHININESS + k] = (a2 if faces_up else b2) if mine else f[SHININESS + k]
        f[GAIN + k] = (a3 if faces_up else b3) if mine else f[GAIN + k]
        f[GAIN + AREA + k] = (a4 if faces_up else b4) if mine else f[GAIN + AREA + k]
        f[GAIN + 2 * AREA + k] = (a5 if faces_up else b5) if mine else f[GAIN + 2 * AREA + k]


@part
def _towards_light(f, n, light):  # type: ignore[no-untyped-def]
    """Direction of the light, and how much would arrive were nothing in its way."""
    is_lamp = light[LAMP] > _ZERO
    lx, ly, lz = light[LIGHT], light[LIGHT + 1], light[LIGHT + 2]
    for k in range(AREA):
        dx = lx - f[PX + k] if is_lamp else lx
        dy = ly - f[PY + k] if is_lamp else ly
        dz = lz - f[PZ + k] if is_lamp else lz
        squared = dx * dx + dy * dy + dz * dz + _TINY
        cosine = (f[NX + k] * dx + f[NY + k] * dy + f[NZ + k] * dz) / np.sqrt(squared)
        arriving = cosine / squared if is_lamp else cosine
        f[DX + k], f[DY + k], f[DZ + k] = dx, dy, dz
        f[LIT + k] = arriving if (arriving > _ZERO) & (n[ID + k] >= 0) else _ZERO
        f[OPEN + k] = _ONE


@part
def _wave(x):  # type: ignore[no-untyped-def]
    """A wave of period 1 between 0 (at whole numbers) and 1, made of parabolas: vectors have no cosine."""
    t = _TWO * abs(x - np.floor(x + _HALF))
    return t * t * (_ONE + _TWO - _TWO * t)


@part
def _cast_pattern(f, light, side):  # type: ignore[no-untyped-def]
    """Take direct light where bars out of sight stand in its way."""
    is_lamp = light[LAMP] > _ZERO
    strength, cos, sin = light[PATTERN], light[PATTERN + 1], light[PATTERN + 2]
    scale_a, scale_b, shade_a, shade_b = light[PATTERN + 3], light[PATTERN + 4], light[PATTERN + 5], light[PATTERN + 6]
    phase_a, phase_b, sharp, warp = light[PATTERN + 7], light[PATTERN + 8], light[PATTERN + 9], light[PATTERN + 10]
    s0, s1, s2, t0, t1, t2 = side[0, 0], side[0, 1], side[0, 2], side[1, 0], side[1, 1], side[1, 2]
    # Distance from the middle of a bar, in periods, at which its shadow begins; below none where it has no width.
    edge_a = _HALF * shade_a + _HALF / sharp if shade_a > _ZERO else -_ONE
    edge_b = _HALF * shade_b + _HALF / sharp if shade_b > _ZERO else -_ONE
    for k in range(AREA):
        x, y, z = f[PX + k], f[PY + k], f[PZ + k]
        drop = _PATTERN_DROP_M / max(f[DZ + k], _STEEPEST)
        s = f[DX + k] * drop if is_lamp else s0 * x + s1 * y + s2 * z
        t = f[DY + k] * drop if is_lamp else t0 * x + t1 * y + t2 * z
        a, b = (cos * s + sin * t) * scale_a + phase_a, (cos * t - sin * s) * scale_b + phase_b
        bent_a = a + warp * (_wave(_HALF * b + _HALF * a) + _wave(np.float32(1.7) * b))
        bent_b = b + warp * (_wave(_HALF * a - np.float32(0.3) * b) + _wave(np.float32(1.3) * a))
        from_a, from_b = abs(bent_a - np.floor(bent_a + _HALF)), abs(bent_b - np.floor(bent_b + _HALF))
        covered = max((edge_a - from_a) * sharp, (edge_b - from_b) * sharp)
        covered = min(max(covered, _ZERO), _ONE)
        f[LIT + k] *= _ONE - strength * covered


@part
def _soil(f, light):  # type: ignore[no-untyped-def]
    """Lighten or darken the albedo where it is trodden or damp."""
    gain, middle, narrow = light[SOIL], light[SOIL + 1], light[SOIL + 2]
    strength, scale_x, scale_y = light[SOIL + 3], light[SOIL + 4], light[SOIL + 5]
    phase_x, phase_y, threshold, wetness = light[SOIL + 6], light[SOIL + 7], light[SOIL + 8], light[SOIL + 9]
    for k in range(AREA):
        across = (f[PY + k] - middle) * narrow
        inside = max(_ONE - across * across, _ZERO)
        trodden = gain * inside * inside if f[NZ + k] > _FACES_UP else _ZERO
        x = (f[PX + k] + f[PZ + k]) * scale_x + phase_x
        y = (f[PY + k] + _HALF * f[PZ + k]) * scale_y + phase_y
        u = x + np.float32(0.35) * _wave(np.float32(1.3) * y) + np.float32(0.12) * _wave(np.float32(4.1) * y)
        v = y + np.float32(0.35) * _wave(np.float32(1.1) * x) + np.float32(0.12) * _wave(np.float32(3.7) * x)
        high = np.sqrt(_wave(u) * _wave(v))
        patch = min(max((high - threshold) * _PATCH_EDGE, _ZERO), _ONE)
        factor = (_ONE + trodden) * (_ONE - strength * patch)
        f[RED + k], f[GREEN + k], f[BLUE + k] = f[RED + k] * factor, f[GREEN + k] * factor, f[BLUE + k] * factor
        f[STRENGTH + k] += wetness * patch


@part
def _shade_by_box(f, rotation, centre, size, longest):  # type: ignore[no-untyped-def]
    """Take the direct light from points whose way to it, longest times D, meets a box."""
    r00, r01, r02, r10, r11, r12 = rotation[0], rotation[1], rotation[2], rotation[3], rotation[4], rotation[5]
    r20, r21, r22 = rotation[6], rotation[7], rotation[8]
    c0, c1, c2, h0, h1, h2 = centre[0], centre[1], centre[2], size[0], size[1], size[2]
    for k in range(AREA):
        x = f[PX + k] + _LIFT_M * f[NX + k] - c0
        y = f[PY + k] + _LIFT_M * f[NY + k] - c1
        z = f[PZ + k] + _LIFT_M * f[NZ + k] - c2
        dx, dy, dz = f[DX + k], f[DY + k], f[DZ + k]
        p0, p1, p2 = r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z
        i0 = _ONE / (r00 * dx + r10 * dy + r20 * dz + _TINY)
        i1 = _ONE / (r01 * dx + r11 * dy + r21 * dz + _TINY)
        i2 = _ONE / (r02 * dx + r12 * dy + r22 * dz + _TINY)
        # The slab of half width h is entered at -p i - h |i| and left at -p i + h |i|.
        w0, w1, w2 = h0 * abs(i0), h1 * abs(i1), h2 * abs(i2)
        enter = max(max(-p0 * i0 - w0, -p1 * i1 - w1), -p2 * i2 - w2)
        leave = min(min(w0 - p0 * i0, w1 - p1 * i1), w2 - p2 * i2)
        f[LIT + k] = _ZERO if (enter < leave) & (leave > _ZERO) & (enter < longest) else f[LIT + k]


@part
def _shade_by_round(f, rotation, centre, size, kind, longest):  # type: ignore[no-untyped-def]
    """The same for a cylinder, a capsule (as a cylinder with its overall length) or a sphere."""
    r00, r01, r02, r10, r11, r12 = rotation[0], rotation[1], rotation[2], rotation[3], rotation[4], rotation[5]
    r20, r21, r22 = rotation[6], rotation[7], rotation[8]
    c0, c1, c2, r2 = centre[0], centre[1], centre[2], size[0] * size[0]
    half = size[0] if kind == SPHERE else (size[1] + size[0] if kind == CAPSULE else size[1])
    axial = _ONE if kind == SPHERE else _ZERO  # a sphere counts the distance along the axis too
    for k in range(AREA):
        x = f[PX + k] + _LIFT_M * f[NX + k] - c0
        y = f[PY + k] + _LIFT_M * f[NY + k] - c1
        z = f[PZ + k] + _LIFT_M * f[NZ + k] - c2
        dx, dy, dz = f[DX + k], f[DY + k], f[DZ + k]
        p0, p1, p2 = r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z
        d0, d1 = r00 * dx + r10 * dy + r20 * dz, r01 * dx + r11 * dy + r21 * dz
        d2 = r02 * dx + r12 * dy + r22 * dz + _TINY
        flat = _ONE / (d0 * d0 + d1 * d1 + axial * d2 * d2 + _TINY)
        middle = -(p0 * d0 + p1 * d1 + axial * p2 * d2) * flat
        q0, q1, q2 = p0 + middle * d0, p1 + middle * d1, axial * (p2 + middle * d2)
        inside = r2 - (q0 * q0 + q1 * q1 + q2 * q2)
        reach = np.sqrt(max(inside, _ZERO) * flat)
        i2 = _ONE / d2
        enter = max(middle - reach, -p2 * i2 - half * abs(i2))
        leave = min(middle + reach, -p2 * i2 + half * abs(i2))
        hit = (inside > _ZERO) & (enter < leave) & (leave > _ZERO) & (enter < longest)
        f[LIT + k] = _ZERO if hit else f[LIT + k]


@part
def _close_off(f, rotation, centre, size, is_box):  # type: ignore[no-untyped-def]
    """Ambient light that a nearby solid takes away: how far it reaches into the ball that rests on the point."""
    r00, r01, r02, r10, r11, r12 = rotation[0], rotation[1], rotation[2], rotation[3], rotation[4], rotation[5]
    r20, r21, r22 = rotation[6], rotation[7], rotation[8]
    c0, c1, c2 = centre[0], centre[1], centre[2]
    h0, h1, h2 = (size[0], size[1], size[2]) if is_box else (_ZERO, _ZERO, size[1])
    radius = _ZERO if is_box else size[0]
    for k in range(AREA):
        x = f[PX + k] + _OPEN_REACH_M * f[NX + k] - c0
        y = f[PY + k] + _OPEN_REACH_M * f[NY + k] - c1
        z = f[PZ + k] + _OPEN_REACH_M * f[NZ + k] - c2
        e0 = max(abs(r00 * x + r10 * y + r20 * z) - h0, _ZERO)
        e1 = max(abs(r01 * x + r11 * y + r21 * z) - h1, _ZERO)
        e2 = max(abs(r02 * x + r12 * y + r22 * z) - h2, _ZERO)
        distance = max(np.sqrt(e0 * e0 + e1 * e1 + e2 * e2) - radius, _ZERO)
        depth = max(_ONE - distance / _OPEN_REACH_M, _ZERO)
        # The worst neighbour counts: steps are one solid inside another, and would darken a wall many times over.
        f[OPEN + k] = min(f[OPEN + k], _ONE - _OPEN_LOSS * depth * depth)


@part
def _find_texels(f, n, pose, pixel_slope):  # type: ignore[no-untyped-def]
    """Which four texels surround a pixel, in the mip level whose texels are about as wide as the pixel."""
    ex, ey, ez = pose[3], pose[7], pose[11]
    for k in range(AREA):
        x, y, z = f[PX + k] - ex, f[PY + k] - ey, f[PZ + k] - ez
        cosine = abs(x * f[NX + k] + y * f[NY + k] + z * f[NZ + k]) / np.sqrt(x * x + y * y + z * z + _TINY)
        # Seen at an angle a pixel covers more texels one way than the other: take their geometric mean.
        footprint = f[T + k] * pixel_slope * f[DENSITY + k] / np.sqrt(max(cosine, _MIN_COSINE))
        # How often _COARSER_FROM can be doubled before it reaches the footprint: their binary codes tell by exponents.
        # Sums of int32 are int64 to numba, hence the casts: half as many fit a vector.
        doublings = np.int32(np.int32(np.float32(footprint).view(np.int32) - _COARSER_CODE) >> _MANTISSA_BITS)
        doublings = min(max(doublings, _NO_DOUBLING), _COARSEST)
        shrink = np.int32(np.int32(_CODE_OF_0 - doublings) << _MANTISSA_BITS).view(np.float32)
        column = f[U + k] * f[DENSITY + k] * shrink - _HALF
        row = f[V + k] * f[DENSITY + k] * shrink - _HALF
        column_floor, row_floor = np.floor(column), np.floor(row)
        f[ACROSS + k], f[DOWN + k] = column - column_floor, row - row_floor
        side = np.int32(np.float32(MIP_SIDE) * shrink)
        # The finer levels hold MIP_SIDE^2 (1 + 1/4 + ...) = 4/3 (MIP_SIDE^2 - side^2) texels.
        base = n[BASE + k] + np.int32(_FINER_TEXELS * (_ONE - shrink * shrink) + _HALF)
        left, top = np.int32(column_floor) & (side - 1), np.int32(row_floor) & (side - 1)
        right, bottom = (left + 1) & (side - 1), (top + 1) & (side - 1)
        n[TEXELS + k] = base + top * side + left
        n[TEXELS + AREA + k] = base + top * side + right
        n[TEXELS + 2 * AREA + k] = base + bottom * side + left
        n[TEXELS + 3 * AREA + k] = base + bottom * side + right


@part
def _fetch_texels(n, texels):  # type: ignore[no-untyped-def]
    """Replace indices by texels; apart from the rest because loads from anywhere do not vectorise."""
    for k in range(4 * AREA):
        n[TEXELS + k] = texels[np.uint32(n[TEXELS + k])]  # an index without sign needs no check for a negative one


@part
def _blend_texels(f, n):  # type: ignore[no-untyped-def]
    """Bilinear albedo from the four texels."""
    for k in range(AREA):
        across, down = f[ACROSS + k], f[DOWN + k]
        wa, wb = (_ONE - across) * (_ONE - down), across * (_ONE - down)
        wc, wd = (_ONE - across) * down, across * down
        a, b, c, d = n[TEXELS + k], n[TEXELS + AREA + k], n[TEXELS + 2 * AREA + k], n[TEXELS + 3 * AREA + k]
        red = wa * np.float32(a & 255) + wb * np.float32(b & 255)
        red += wc * np.float32(c & 255) + wd * np.float32(d & 255)
        green = wa * np.float32((a >> 8) & 255) + wb * np.float32((b >> 8) & 255)
        green += wc * np.float32((c >> 8) & 255) + wd * np.float32((d >> 8) & 255)
        blue = wa * np.float32((a >> 16) & 255) + wb * np.float32((b >> 16) & 255)
        blue += wc * np.float32((c >> 16) & 255) + wd * np.float32((d >> 16) & 255)
        f[RED + k] = red * red * f[GAIN + k]
        f[GREEN + k] = green * green * f[GAIN + AREA + k]
        f[BLUE + k] = blue * blue * f[GAIN + 2 * AREA + k]


@part
def _radiance(f, n, light, pose):  # type: ignore[no-untyped-def]
    """Light the albedo; where nothing was hit, the sky."""
    gloss, exposure = light[GLOSS], light[EXPOSURE]
    lr, lg, lb = light[COLOUR], light[COLOUR + 1], light[COLOUR + 2]
    ar, ag, ab = light[AMBIENT], light[AMBIENT + 1], light[AMBIENT + 2]
    hr, hg, hb = light[HORIZON], light[HORIZON + 1], light[HORIZON + 2]
    zr, zg, zb = light[ZENITH] - hr, light[ZENITH + 1] - hg, light[ZENITH + 2] - hb
    ex, ey, ez = pose[3], pose[7], pose[11]
    tilt_x, tilt_y, tilt_z = light[TILT], light[TILT + 1], light[TILT + 2]
    corner, grime = light[CORNER] / _OPEN_LOSS, light[GRIME] / _OPEN_LOSS
    for k in range(AREA):
        nx, ny, nz = f[NX + k], f[NY + k], f[NZ + k]
        dx, dy, dz, lit, closed = f[DX + k], f[DY + k], f[DZ + k], f[LIT + k], _ONE - f[OPEN + k]
        opened, clean = _ONE - corner * closed, _ONE - grime * closed
        vx, vy, vz = ex - f[PX + k], ey - f[PY + k], ez - f[PZ + k]
        to_eye = _ONE / np.sqrt(vx * vx + vy * vy + vz * vz + _TINY)
        to_light = _ONE / np.sqrt(dx * dx + dy * dy + dz * dz + _TINY)
        mx, my, mz = vx * to_eye + dx * to_light, vy * to_eye + dy * to_light, vz * to_eye + dz * to_light
        half = (nx * mx + ny * my + nz * mz) / np.sqrt(mx * mx + my * my + mz * mz + _TINY)
        half = half if half > _ZERO else _ZERO
        strength, shininess = f[STRENGTH + k] * gloss, f[SHININESS + k]
        # A rational stand-in for half ** shininess, scaled so that a narrow lobe is a bright one.
        lobe = half / (shininess - shininess * half + half + _TINY)
        shine = strength * lobe * lobe * (_HALF + _LOBE_PEAK * shininess) * lit
        grazing = _ONE - abs(nx * vx + ny * vy + nz * vz) * to_eye
        mirror = strength * grazing * grazing * grazing * opened
        ambient = opened * clean * (_AMBIENT_MEAN + tilt_x * nx + tilt_y * ny + tilt_z * nz)
        diffuse = clean * lit
        up = -vz * to_eye  # of a ray into the sky
        dim = _ONE if up >= _ZERO else _BELOW_HORIZON
        high = np.sqrt(up if up > _ZERO else _ZERO)
        hit = n[ID + k] >= 0
        red = f[RED + k] * (ar * ambient + lr * diffuse) + shine * lr + mirror * ar
        green = f[GREEN + k] * (ag * ambient + lg * diffuse) + shine * lg + mirror * ag
        blue = f[BLUE + k] * (ab * ambient + lb * diffuse) + shine * lb + mirror * ab
        f[RED + k] = exposure * (red if hit else dim * (hr + zr * high))
        f[GREEN + k] = exposure * (green if hit else dim * (hg + zg * high))
        f[BLUE + k] = exposure * (blue if hit else dim * (hb + zb * high))


@part
def _encode(f):  # type: ignore[no-untyped-def]
    """Radiance to sRGB times 255: a shoulder instead of clipping, then the curve as a sum of roots."""
    for k in range(3 * AREA):
        x = f[RED + k]
        over = (x - _KNEE) / (_ONE - _KNEE)
        x = min(_KNEE + (_ONE - _KNEE) * np.float32(1.15) * over / (_ONE + over), _ONE) if x > _KNEE else x
        x = max(x, _ZERO)
        r2 = np.sqrt(x)
        r4 = np.sqrt(r2)
        r8 = np.sqrt(r4)
        curve = _CURVE_1 * x + _CURVE_2 * r2 + _CURVE_4 * r4 + _CURVE_8 * r8
        f[RED + k] = max(np.float32(12.92 * 255.0) * x if x < np.float32(0.0031308) else curve, _ZERO) + _HALF


@part
def _bounds(f, low, high):  # type: ignore[no-untyped-def]
    """Box around the tile's points, into low and high, both (3,)."""
    # Eight values at once, then four: a running minimum would wait for its last result, and vectors for each other's.
    for a in range(3):
        p, s = PX + a * AREA, SCRATCH + a * _EIGHTH
        for k in range(_EIGHTH):
            x0, x1, x2, x3 = f[p + k], f[p + _EIGHTH + k], f[p + 2 * _EIGHTH + k], f[p + 3 * _EIGHTH + k]
            x4, x5, x6, x7 = (
                f[p + 4 * _EIGHTH + k],
                f[p + 5 * _EIGHTH + k],
                f[p + 6 * _EIGHTH + k],
                f[p + 7 * _EIGHTH + k],
            )
            f[s + k] = min(min(min(x0, x1), min(x2, x3)), min(min(x4, x5), min(x6, x7)))
            f[s + AREA + k] = max(max(max(x0, x1), max(x2, x3)), max(max(x4, x5), max(x6, x7)))
    for a in range(3):
        s = SCRATCH + a * _EIGHTH
        for k in range(8):
            f[s + k] = min(min(f[s + k], f[s + 8 + k]), min(f[s + 16 + k], f[s + 24 + k]))
            x0, x1, x2, x3 = f[s + AREA + k], f[s + AREA + 8 + k], f[s + AREA + 16 + k], f[s + AREA + 24 + k]
            f[s + AREA + k] = max(max(x0, x1), max(x2, x3))
        lowest, highest = f[s], f[s + AREA]
        for k in range(1, 8):
            lowest, highest = min(lowest, f[s + k]), max(highest, f[s + AREA + k])
        low[a], high[a] = lowest, highest


@part
def _is_dark(f):  # type: ignore[no-untyped-def]
    total = _ZERO
    for k in range(AREA):
        total += f[LIT + k]
    return total == _ZERO


@part
def _neighbours(low, high, solid_low, solid_high, found):  # type: ignore[no-untyped-def]
    """List the solids that can take ambient light from points in the box low..high; returns their number."""
    margin = _TWO * _OPEN_REACH_M
    x0, y0, z0 = low[0] - margin, low[1] - margin, low[2] - margin
    x1, y1, z1 = high[0] + margin, high[1] + margin, high[2] + margin
    count = 0
    for i in range(solid_low.shape[0]):
        if (
            solid_low[i, 0] < x1
            and solid_high[i, 0] > x0
            and solid_low[i, 1] < y1
            and solid_high[i, 1] > y0
            and solid_low[i, 2] < z1
            and solid_high[i, 2] > z0
        ):
            found[count] = i
            count += 1
    return count


@part
def _way_to_light(low, high, to_light, is_lamp):  # type: ignore[no-untyped-def]
    """Interval of one coordinate on the ways to the light from points in low..high."""
    if is_lamp:
        return min(low + _LIFT_M, to_light), max(high - _LIFT_M, to_light)
    return low + _LIFT_M if to_light >= _ZERO else -_HUGE, high - _LIFT_M if to_light <= _ZERO else _HUGE


@part
def _occluders(low, high, light, side, solid_low, solid_high, solid_side, found):  # type: ignore[no-untyped-def]
    """List the solids that can stand between the box low..high and the light; returns their number.

    side holds two directions across a sun's light, (2, 3), and solid_side how far solids reach along them, (n, 4).
    """
    is_lamp = light[LAMP] > _ZERO
    x0, x1 = _way_to_light(low[0], high[0], light[LIGHT], is_lamp)
    y0, y1 = _way_to_light(low[1], high[1], light[LIGHT + 1], is_lamp)
    z0, z1 = _way_to_light(low[2], high[2], light[LIGHT + 2], is_lamp)
    middle_s, reach_s, middle_t, reach_t = _ZERO, _ZERO, _ZERO, _ZERO
    for a in range(3):
        middle, reach = (low[a] + high[a]) * _HALF, (high[a] - low[a]) * _HALF
        middle_s, reach_s = middle_s + side[0, a] * middle, reach_s + abs(side[0, a]) * reach
        middle_t, reach_t = middle_t + side[1, a] * middle, reach_t + abs(side[1, a]) * reach
    if is_lamp:  # its ways do not run in parallel
        reach_s, reach_t = _HUGE, _HUGE
    count = 0
    for i in range(solid_low.shape[0]):
        if (
            solid_high[i, 2] > z0
            and solid_low[i, 2] < z1
            and solid_high[i, 0] > x0
            and solid_low[i, 0] < x1
            and solid_high[i, 1] > y0
            and solid_low[i, 1] < y1
            and solid_side[i, 0] <= middle_s + reach_s
            and solid_side[i, 1] >= middle_s - reach_s
            and solid_side[i, 2] <= middle_t + reach_t
            and solid_side[i, 3] >= middle_t - reach_t
        ):
            found[count] = i
            count += 1
    return count


@part
def _load(f, n, u0, v0, rx, ry, depth, ids, seen, stamp, present):  # type: ignore[no-untyped-def]
    """Fill the buffers from the images; returns how many different solids are seen, listed in present."""
    height, width = depth.shape
    row, column = v0 // TILE, u0 // TILE
    for k in range(AREA):
        f[RX + k], f[RY + k] = rx[row, column, k], ry[row, column, k]
    if v0 + TILE <= height and u0 + TILE <= width:
        for v in range(TILE):
            for u in range(TILE):
                k = v * TILE + u
                f[T + k], n[ID + k] = depth[v0 + v, u0 + u], ids[v0 + v, u0 + u]
    else:
        for k in range(AREA):
            v, u = v0 + k // TILE, u0 + k % TILE
            inside = v < height and u < width
            v, u = min(v, height - 1), min(u, width - 1)
            f[T + k], n[ID + k] = depth[v, u], ids[v, u] if inside else -1
    first, differing, sky = n[ID], np.int32(0), np.int32(0)
    for k in range(AREA):
        differing |= n[ID + k] ^ first
        sky |= n[ID + k]
    if sky < 0:
        for k in range(AREA):  # a ray into the sky gets any length that keeps the rest finite
            f[T + k] = f[T + k] if n[ID + k] >= 0 else _ONE
    if differing == 0:
        present[0] = first
        return 1 if first >= 0 else 0
    count, last = 0, -1
    for k in range(AREA):
        index = n[ID + k]
        if index == last:
            continue
        last = index
        if index >= 0 and seen[index] != stamp:
            seen[index] = stamp
            present[count] = index
            count += 1
    return count


@part
def _store(f, n, u0, v0, rgb, regions):  # type: ignore[no-untyped-def]
    """Copy colours and regions from the buffers to the images."""
    height, width = regions.shape
    columns = min(TILE, width - u0)
    for k in range(AREA):  # into the blocks of the texels, which are not needed any more
        region = (n[ID + k] * _FOUR_FACES + n[FACE + k]) * _LIT_OR_NOT + np.int32(f[LIT + k] > _ZERO)
        n[TEXELS + k] = region if n[ID + k] >= 0 else _NO_REGION
        red, green, blue = np.int32(f[RED + k]), np.int32(f[GREEN + k]), np.int32(f[BLUE + k])
        n[TEXELS + AREA + k] = red | (green << _BYTE) | (blue << _TWO_BYTES)
    for row in range(min(TILE, height - v0)):
        for u in range(columns):
            regions[v0 + row, u0 + u] = n[TEXELS + row * TILE + u]
        line = rgb[v0 + row, u0 : u0 + columns]
        for u in range(columns):
            colour = n[TEXELS + AREA + row * TILE + u]
            line[u, 0] = np.uint8(colour & _LOWEST_BYTE)
            line[u, 1] = np.uint8((colour >> _BYTE) & _LOWEST_BYTE)
            line[u, 2] = np.uint8(colour >> _TWO_BYTES)


@kernel
def shade_rows(  # type: ignore[no-untyped-def]
    rows, rx, ry, kinds, sizes, m, o, rotations, centres, shifts, looks, low, high, solid_side,
    texels, look_base, look_values, light, side, pose, pixel_slope, depth, ids, rgb, regions,
):  # fmt: skip
    """Colour whole rows of tiles.

    Args:
        rows: (k,) int64 indices of the rows of tiles.
        rx, ry: (rows of tiles, columns of tiles, AREA) float32 slopes of the rays.
        kinds, sizes, m, o: of n solids, as for `visibility.trace_rows`.
        rotations: (n, 9) float32 local to world, row by row; centres: (n, 3) float32.
        shifts: (n, 3) float32 origin of the texture coordinates in the local frame.
        looks: (n, 2) int32, look of faces that point up and of the others.
        low, high: (n, 3) float32 world bounding boxes.
        solid_side: (n, 4) float32 low, high along the two directions in side.
        texels: (textures * MIP_TEXELS,) int32, red | green << 8 | blue << 16, each 255 times the root of linear.
        look_base: (looks,) int32 first texel of each look's texture.
        look_values: (looks, NUM_LOOK) float32; gains are per squared texel value.
        light: (NUM_SETTINGS,) float32.
        side: (2, 3) float32 unit vectors across the light's direction.
        pose: (12,) float32 camera_to_world, row by row.
        pixel_slope: float32, width of a pixel at a depth of 1 m, metres.
        depth, ids: (H, W) as written by `visibility.trace_rows`.
        rgb: (H, W, 3) uint8 out.
        regions: (H, W) int32 out; pixels of one region lie on one face, all in the light or all in shadow.
    """
    width, count = depth.shape[1], kinds.shape[0]
    f, n = np.zeros(NUM_FLOATS, np.float32), np.zeros(NUM_INTS, np.int32)
    tile_low, tile_high = np.empty(3, np.float32), np.empty(3, np.float32)
    seen, present, others = np.zeros(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    stamp = 0
    longest = _ONE if light[LAMP] > _ZERO else _HUGE
    for row in rows:
        v0 = row * TILE
        for u0 in range(0, width, TILE):
            stamp += 1
            found = _load(f, n, u0, v0, rx, ry, depth, ids, seen, stamp, present)
            _points(f, pose)
            for j in range(found):
                i = present[j]
                if kinds[i] == BOX:
                    _box_surface(f, n, m[i], o[i], sizes[i], rotations[i], shifts[i], np.int32(i))
                else:
                    _round_surface(f, n, m[i], o[i], sizes[i], rotations[i], kinds[i], np.int32(i))
                up, other = looks[i, 0], looks[i, 1]
                _apply_look(f, n, look_base[up], look_values[up], look_base[other], look_values[other], np.int32(i))
            if found > 0:
                _towards_light(f, n, light)
                _bounds(f, tile_low, tile_high)
                _find_texels(f, n, pose, pixel_slope)
                _fetch_texels(n, texels)
                _blend_texels(f, n)
                if light[SOIL] != _ZERO or light[SOIL + 3] != _ZERO:
                    _soil(f, light)
                for j in range(_neighbours(tile_low, tile_high, low, high, others)):
                    i = others[j]
                    if found > 1 or present[0] != i:
                        _close_off(f, rotations[i], centres[i], sizes[i], kinds[i] == BOX)
                if light[PATTERN] > _ZERO:
                    _cast_pattern(f, light, side)
                if light[SHADOWS] > _ZERO and not _is_dark(f):
                    for j in range(_occluders(tile_low, tile_high, light, side, low, high, solid_side, others)):
                        i = others[j]
                        if kinds[i] == BOX:
                            _shade_by_box(f, rotations[i], centres[i], sizes[i], longest)
                        else:
                            _shade_by_round(f, rotations[i], centres[i], sizes[i], kinds[i], longest)
            _radiance(f, n, light, pose)
            _encode(f)
            _store(f, n, u0, v0, rgb, regions)
