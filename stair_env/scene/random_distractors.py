"""Random distractors, clear of the flight."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from stair_env.scene.objects.distractor_sizes import draw_size
from stair_env.scene.objects.distractors import FLAT_KINDS, DistractorSpec
from stair_env.scene.objects.palette import MAT_LOOKS, SOLID_LOOKS
from stair_env.scene.surroundings import Enclosure, SurroundingsSpec
from stair_env.stairs import StairSpec

CORRIDOR_MARGIN_M = 0.25  # solid things keep this far from where a robot walks
BESIDE_ROOM_M = 0.5  # least width beside the flight for something to stand there
WALL_KINDS = (
    "shelf", "blinds", "bench", "boxes", "shutter", "shutter", "wall_panel", "wall_panel", "door_frame", "pipes", "bin",
    "plant",
)  # fmt: skip
BESIDE_KINDS = (
    "fence", "fence", "column", "boxes", "planks", "bench", "shelf", "person", "person", "plant", "plant", "bin", "bag",
    "board_pile", "pipes",
)  # fmt: skip
FLAT_IN_WAY = ("crosswalk", "floor_stripes", "tile_seams", "mat", "road_marking", "drain", "floor_field")
# What has many parts, hence costs time: for data sets.
CROWDED_WALL_KINDS = (*WALL_KINDS, "bookcase", "bookcase", "radiator", "radiator", "ladder", "chair", "bicycle")
CROWDED_BESIDE_KINDS = (*BESIDE_KINDS, "person", "chair", "bicycle", "ladder", "benches", "kerb", "bookcase")
CROWDED_FLAT = (*FLAT_IN_WAY, "cable")
ON_FLIGHT_KINDS = ("person", "person", "person", "plant", "bag", "bag", "boxes", "bin")
NEGATIVE_KINDS = (
    "crosswalk", "crosswalk", "crosswalk", "floor_stripes", "tile_seams", "mat", "planks", "planks", "shelf", "shelf",
    "ramp", "fence", "fence", "blinds", "blinds", "bench", "boxes", "boxes", "column", "shutter", "shutter", "bookcase",
    "bookcase", "radiator", "radiator", "ladder", "ladder", "kerb", "kerb", "road_marking", "drain", "board_pile",
    "board_pile", "benches", "benches", "wall_panel", "wall_panel", "striped_ramp", "floor_field", "floor_field",
    "person", "plant", "bin", "chair", "bicycle", "pipes", "door_frame", "cable",
)  # fmt: skip
BACKDROPS = ("shutter", "bookcase", "blinds", "wall_panel", "shelf", "radiator")  # at the end of the view


_REACH_ON = {"ramp": 1.0, "striped_ramp": 0.6, "kerb": 0.2, "door_frame": 0.9}  # beyond the size along x, metres


def _make(
    rng: np.random.Generator, kind: str, position: tuple[float, float, float], yaw_spread: float, yaw: float = 0.0
) -> DistractorSpec:
    size, count = draw_size(rng, kind)
    return DistractorSpec(
        kind,
        position,
        yaw + float(np.clip(rng.normal(0.0, yaw_spread), -1.0, 1.0)),
        size,
        count,
        seed=int(rng.integers(2**31)),
        look=int(rng.integers(*(MAT_LOOKS if kind == "mat" else SOLID_LOOKS))),
    )


def _radius(spec: DistractorSpec) -> float:
    """Half of the greatest horizontal extent, with some room for how the parts are set, metres."""
    length, width, _ = spec.size
    length += 2.0 * _REACH_ON.get(spec.kind, 0.0)
    if spec.kind == "boxes":
        width *= 1.0 + 1.15 * ((spec.count + 1) // 2)
    return 0.5 * math.hypot(length, width)


def draw_distractors(
    rng: np.random.Generator,
    stairs: StairSpec | None,
    surroundings: SurroundingsSpec,
    room: Enclosure,
    most: int = 4,
    crowded: bool = False,
) -> tuple[DistractorSpec, ...]:
    """One to `most` distractors where they are likely to be seen.

    Solid ones keep clear of the flight, of the way to it and of the way on; painted ones may lie in the way, but not
    on the flight. Without stairs they stand in the middle of the view.

    Args:
        rng: the source of all chance.
        stairs: the staircase, or None for a scene without one.
        surroundings: the walls.
        room: where they stand.
        most: how many distractors at most.
        crowded: whether there are more of them, and such of many parts.
    """
    if stairs is None:
        return _for_negative(rng, room, int(rng.integers(2, most + 3)))
    count = int(rng.integers(1, most + 1 + 2 * crowded))
    found: list[DistractorSpec] = []
    for _ in range(count):
        where = rng.random()
        if where < 0.3:
            candidate = _in_the_way(rng, stairs, CROWDED_FLAT if crowded else FLAT_IN_WAY)
        elif where < 0.6:
            candidate = _at_back_wall(rng, stairs, surroundings, room, CROWDED_WALL_KINDS if crowded else WALL_KINDS)
        else:
            candidate = _beside(rng, stairs, room, CROWDED_BESIDE_KINDS if crowded else BESIDE_KINDS)
        if candidate is not None:
            found.append(candidate)
    return tuple(found)


def draw_obstacles(rng: np.random.Generator, stairs: StairSpec) -> tuple[DistractorSpec, ...]:
    """One to three people or things on the flight or before it, which hide parts of its lines."""
    profile, half = stairs.profile(), stairs.flight_width / 2
    last = float(profile.edge_x[-1])
    found = []
    for _ in range(int(rng.integers(1, 4))):
        kind = ON_FLIGHT_KINDS[int(rng.integers(len(ON_FLIGHT_KINDS)))]
        made = _make(rng, kind, (0.0, 0.0, 0.0), 0.4, float(rng.choice([0.0, math.pi])))
        x = float(rng.uniform(-1.2, last + 0.6))
        step = int(np.searchsorted(profile.edge_x, x))
        if 0 < step < len(profile.edge_x):  # in the middle of its tread
            x = float(profile.edge_x[step - 1 : step + 1].mean())
        y = float(rng.uniform(-0.9, 0.9)) * half
        slim = dataclasses.replace(made, size=_slim(made.size, stairs.tread_depth)) if kind != "person" else made
        found.append(dataclasses.replace(slim, position=(x, y, float(profile.height_at(x)))))
    return tuple(found)


def _slim(size: tuple[float, float, float], depth: float) -> tuple[float, float, float]:
    """Small enough to stand on a tread, metres."""
    share = min(1.0, 0.9 * depth / size[0])
    return (size[0] * share, size[1] * max(share, 0.6), size[2] * max(share, 0.5))


def _pick(rng: np.random.Generator, kinds: tuple[str, ...]) -> str:
    return kinds[int(rng.integers(len(kinds)))]


def _in_the_way(rng: np.random.Generator, stairs: StairSpec, kinds: tuple[str, ...]) -> DistractorSpec | None:
    """Paint on the floor before the first edge (up) or behind the last (down)."""
    profile = stairs.profile()
    made = _make(rng, _pick(rng, kinds), (0.0, 0.0, 0.0), 0.08)
    reach = _radius(made) + 0.15
    if stairs.direction == "down":
        x = float(profile.edge_x[-1]) + reach + float(rng.uniform(0.0, 1.0))
    else:
        x = -reach - float(rng.uniform(0.0, 0.8))
    return DistractorSpec(
        made.kind, (x, float(rng.normal(0.0, 0.15)), 0.0), made.yaw_rad, made.size, made.count, made.seed, made.look
    )


def _at_back_wall(
    rng: np.random.Generator,
    stairs: StairSpec,
    surroundings: SurroundingsSpec,
    room: Enclosure,
    kinds: tuple[str, ...],
) -> DistractorSpec | None:
    """Furniture against the back wall, when there is room before it."""
    if surroundings.kind == "plain" or surroundings.back_gap < 0.7:
        return None
    made = _make(rng, _pick(rng, kinds), (0.0, 0.0, 0.0), 0.02)
    side_room = (room.y_left - room.y_right) / 2 - _radius(made)
    if side_room <= 0.0:
        return None
    middle = (room.y_left + room.y_right) / 2
    position = (room.x_high - made.size[0] / 2 - 0.08, middle + float(rng.uniform(-1, 1)) * side_room, room.z_back)
    return DistractorSpec(made.kind, position, made.yaw_rad, made.size, made.count, made.seed, made.look)


def _beside(
    rng: np.random.Generator, stairs: StairSpec, room: Enclosure, kinds: tuple[str, ...]
) -> DistractorSpec | None:
    """On the ground left or right of the flight."""
    half = stairs.flight_width / 2
    side = 1.0 if rng.random() < 0.5 else -1.0
    space = min((room.y_left - half) if side > 0 else (-half - room.y_right), 3.0)
    made = _make(
        rng, _pick(rng, kinds), (0.0, 0.0, 0.0), 0.15, float(rng.choice([0.0, 0.0, math.pi / 2, -math.pi / 2]))
    )
    reach = _radius(made)
    lowest, highest = half + CORRIDOR_MARGIN_M + reach, half + space - reach
    if space < BESIDE_ROOM_M or lowest > highest:
        return None
    last = float(stairs.profile().edge_x[-1])
    x_low, x_high = (0.5, last + 1.5) if stairs.direction == "down" else (-0.8, last)
    x = float(rng.uniform(x_low, max(x_high, x_low + 0.1)))
    y = side * float(rng.uniform(lowest, highest))
    return DistractorSpec(made.kind, (x, y, 0.0), made.yaw_rad, made.size, made.count, made.seed, made.look)


def _for_negative(rng: np.random.Generator, room: Enclosure, count: int) -> tuple[DistractorSpec, ...]:
    """Spread along the view, the nearest first, each further off than the one before; often a backdrop ends it."""
    found: list[DistractorSpec] = []
    x, end = float(rng.uniform(-0.6, 0.0)), room.x_high
    if rng.random() < 0.5:
        made = _make(rng, _pick(rng, BACKDROPS), (0.0, 0.0, 0.0), 0.02)
        end = room.x_high - made.size[0] - 0.1
        side = (room.y_left - room.y_right) / 2 - _radius(made)
        y = (room.y_left + room.y_right) / 2 + float(np.clip(rng.normal(0.0, 0.5), -side, side)) * (side > 0)
        found.append(dataclasses.replace(made, position=(room.x_high - made.size[0] / 2 - 0.05, y, 0.0)))
    for _ in range(count):
        kind = _pick(rng, NEGATIVE_KINDS)
        flat = kind in FLAT_KINDS
        made = _make(rng, kind, (0.0, 0.0, 0.0), 0.6 if flat else 0.15)
        reach = _radius(made) if kind == "boxes" or flat else made.size[0] / 2 + 0.15 + _REACH_ON.get(kind, 0.0)
        if x + 2 * reach > end:
            continue
        x += reach
        found.append(dataclasses.replace(made, position=(x, float(np.clip(rng.normal(0.0, 0.3), -0.8, 0.8)), 0.0)))
        x += reach
    return tuple(found)
