"""A staircase as solid shapes.

One list of shapes serves everyone: the physics builds its collision bodies from it, the renderers draw it, and the
labels of a data set are its edges. Shapes live in the stair frame (see `stair_env.stairs`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stair_env.stairs import StairSpec

ShapeKind = Literal["box", "sphere", "cylinder", "capsule"]

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # x, y, z, w as in PyBullet and SciPy

IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)
SLAB_THICKNESS_M = 0.04  # of a tread that overhangs or stands free
START_DEPTH_M = 3.0  # floor before the first edge, and after the last when the stairs end on the ground
OPEN_TREAD_OVERLAP_M = 0.02
FLOOR_MARGIN_M = 6.0  # floor beyond the ends and sides of the stairs
WALL_THICKNESS_M = 0.1
WALL_HEIGHT_M = 2.2
RAIL_HEIGHT_M = 0.9
RAIL_RADIUS_M = 0.02
STRINGER_THICKNESS_M = 0.04


@dataclass(frozen=True)
class Shape:
    """One convex solid.

    Attributes:
        kind: "box", "sphere", "cylinder" or "capsule" (axis along local z).
        position: centre in the parent frame, metres.
        orientation: quaternion (x, y, z, w).
        size: box: half extents (x, y, z); sphere: (radius, 0, 0); cylinder, capsule: (radius, half length, 0), where
            a capsule's half length leaves out its round ends.
        surface: what it is, which decides how it looks: "step", "floor", "wall", "rail", "stringer", "robot",
            "distractor:NAME".
        collides: whether the physics knows it (thin paint does not).
    """

    kind: ShapeKind
    position: Vector3
    size: Vector3
    orientation: Quaternion = IDENTITY
    surface: str = "step"
    collides: bool = True


def vector3(values: Sequence[float] | np.ndarray) -> Vector3:
    """Three plain floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def box_between(low: Vector3, high: Vector3, surface: str) -> Shape:
    """Axis-aligned box from its two extreme corners, metres."""
    return Shape("box", vector3((np.add(low, high)) / 2), vector3(np.subtract(high, low) / 2), surface=surface)


def build_stair_shapes(spec: StairSpec) -> tuple[Shape, ...]:
    """Every solid of a staircase and the floors it joins, in the stair frame.

    Args:
        spec: the staircase.

    Returns:
        Shapes in a fixed order: the ground, treads in walking direction, then walls, rails and stringers.
    """
    shapes = [_ground(spec), *_treads(spec)]
    shapes.extend(_side_walls(spec))
    if spec.handrails:
        shapes.extend(_handrails(spec))
    if spec.stringers:
        shapes.extend(_stringers(spec))
    return tuple(shapes)


def _x_limits(spec: StairSpec) -> tuple[float, float]:
    """Where the floor that a robot starts on begins, and where the one it ends on ends."""
    last = float(spec.profile().edge_x[-1])
    return -START_DEPTH_M, last + (spec.landing_depth if spec.direction == "up" else START_DEPTH_M)


def _ground(spec: StairSpec) -> Shape:
    first, last = _x_limits(spec)
    half_y = spec.flight_width / 2 + FLOOR_MARGIN_M
    return box_between((first - FLOOR_MARGIN_M, -half_y, -0.5), (last + FLOOR_MARGIN_M, half_y, 0.0), "floor")


def _treads(spec: StairSpec) -> list[Shape]:
    """Bodies reach down to the ground; an overhanging nosing or an open riser is a slab."""
    profile, half_y = spec.profile(), spec.flight_width / 2
    nosing_x = np.concatenate([[_x_limits(spec)[0]], profile.edge_x, [_x_limits(spec)[1]]])
    side = np.concatenate([[0.0], np.sign(profile.rises), [0.0]])  # +1: the level to the right is the higher one
    riser_x = nosing_x + side * spec.nosing_overhang
    shapes: list[Shape] = []
    for level, z in enumerate(profile.level_z):
        if z <= 0.0:
            continue  # the ground itself
        slab_low = float(z) - SLAB_THICKNESS_M
        rises_here, falls_after = side[level] > 0, side[level + 1] < 0
        inner_level = 0 < level < len(profile.level_z) - 1
        if spec.open_risers and inner_level:
            left = nosing_x[level] - (0.0 if rises_here else OPEN_TREAD_OVERLAP_M)
            right = nosing_x[level + 1] + (0.0 if falls_after else OPEN_TREAD_OVERLAP_M)
            shapes.append(box_between((left, -half_y, slab_low), (right, half_y, float(z)), "step"))
            continue
        shapes.append(box_between((riser_x[level], -half_y, 0.0), (riser_x[level + 1], half_y, float(z)), "step"))
        if spec.nosing_overhang > 0 and rises_here:
            shapes.append(box_between((nosing_x[level], -half_y, slab_low), (riser_x[level], half_y, float(z)), "step"))
        if spec.nosing_overhang > 0 and falls_after:
            shapes.append(
                box_between((riser_x[level + 1], -half_y, slab_low), (nosing_x[level + 1], half_y, float(z)), "step")
            )
    return shapes


def _side_walls(spec: StairSpec) -> list[Shape]:
    profile = spec.profile()
    x_low, x_high = float(profile.edge_x[0]) - 0.6, float(profile.edge_x[-1]) + 0.6
    top = float(profile.level_z.max()) + WALL_HEIGHT_M
    half_y = spec.flight_width / 2
    shapes = []
    for side in _sides(spec, with_wall=True):
        near, far = sorted((side * half_y, side * (half_y + WALL_THICKNESS_M)))
        shapes.append(box_between((x_low, near, 0.0), (x_high, far, top), "wall"))
    return shapes


def _sides(spec: StairSpec, with_wall: bool) -> tuple[int, ...]:
    """+1 for left and -1 for right, those that have (or lack) a wall."""
    walls = {"none": (), "left": (1,), "right": (-1,), "both": (1, -1)}[spec.side_walls]
    return tuple(side for side in (1, -1) if (side in walls) == with_wall)


def _flights(spec: StairSpec) -> list[tuple[np.ndarray, np.ndarray]]:
    """(x, z) of the first and last nosing line of each flight, each (2,), metres."""
    profile = spec.profile()
    n = spec.num_steps
    starts = [0] if spec.direction != "up_down" else [0, n]
    return [
        (profile.edge_x[[i, i + n - 1]], np.maximum(profile.level_z[[i, i + n - 1]], profile.level_z[[i + 1, i + n]]))
        for i in starts
    ]


def _beam(start: np.ndarray, end: np.ndarray, radius: float, surface: str) -> Shape:
    """Cylinder between two points, both (3,), metres."""
    along = end - start
    length = float(np.linalg.norm(along))
    orientation = _turn_of_z_onto(vector3(along / length))
    return Shape("cylinder", vector3((start + end) / 2), (radius, length / 2, 0.0), orientation, surface)


def _turn_of_z_onto(direction: Vector3) -> Quaternion:
    """Smallest rotation that turns the z axis onto a unit vector, which must not be -z."""
    x, y, z = direction
    norm = math.sqrt(2.0 + 2.0 * z)
    return -y / norm, x / norm, 0.0, (1.0 + z) / norm


def _handrails(spec: StairSpec) -> list[Shape]:
    shapes = []
    up = np.array([0.0, 0.0, RAIL_HEIGHT_M])
    for x, z in _flights(spec):
        for side in _sides(spec, with_wall=False):
            y = side * (spec.flight_width / 2 - RAIL_RADIUS_M)
            feet = [np.array([x[k], y, z[k]]) for k in range(2)]
            if spec.num_steps > 1:
                shapes.append(_beam(feet[0] + up, feet[1] + up, RAIL_RADIUS_M, "rail"))
            shapes.extend(_beam(foot, foot + up, RAIL_RADIUS_M, "rail") for foot in feet)
    return shapes


def _stringers(spec: StairSpec) -> list[Shape]:
    if spec.num_steps < 2:
        return []
    shapes = []
    for x, z in _flights(spec):
        start, end = np.array([x[0], 0.0, z[0]]), np.array([x[1], 0.0, z[1]])
        along, pitch = end - start, -math.atan2(z[1] - z[0], x[1] - x[0])
        size = (float(np.linalg.norm(along)) / 2, STRINGER_THICKNESS_M / 2, spec.riser_height)
        orientation = (0.0, math.sin(pitch / 2), 0.0, math.cos(pitch / 2))
        for side in (1, -1):
            y = side * (spec.flight_width + STRINGER_THICKNESS_M) / 2
            middle = vector3((start + end) / 2 + [0.0, y, -spec.riser_height / 2])
            shapes.append(Shape("box", middle, size, orientation, "stringer"))
    return shapes
