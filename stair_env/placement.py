"""Random distractors, clear of the flight."""

from __future__ import annotations

import math

import numpy as np

from stair_env.distractors import DistractorSpec
from stair_env.palette import MAT_LOOKS, SOLID_LOOKS
from stair_env.stairs import StairSpec
from stair_env.surroundings import Enclosure, SurroundingsSpec

CORRIDOR_MARGIN_M = 0.25  # solid things keep this far from where a robot walks
BESIDE_ROOM_M = 0.5  # least width beside the flight for something to stand there
WALL_KINDS = ("shelf", "blinds", "bench", "boxes")
BESIDE_KINDS = ("fence", "fence", "column", "boxes", "planks", "bench", "shelf")
FLAT_IN_WAY = ("crosswalk", "floor_stripes", "tile_seams", "mat")
NEGATIVE_KINDS = (
    "crosswalk", "crosswalk", "floor_stripes", "tile_seams", "mat", "planks", "planks", "shelf", "shelf", "ramp",
    "fence", "fence", "blinds", "bench", "boxes", "column",
)  # fmt: skip


def _draw(rng: np.random.Generator, kind: str) -> tuple[tuple[float, float, float], int]:
    """Size along x, y, z in metres and count of a distractor."""
    u = rng.uniform
    if kind == "crosswalk":
        count = int(rng.integers(3, 8))
        return (count * float(u(0.35, 0.8)), float(u(1.2, 3.0)), 0.01), count
    if kind == "floor_stripes":
        count = int(rng.integers(1, 5))
        return (count * float(u(0.25, 0.7)), float(u(1.0, 4.0)), 0.01), count
    if kind == "tile_seams":
        count = int(rng.integers(3, 10))
        return (count * float(u(0.25, 0.6)), float(u(1.5, 4.0)), 0.01), count
    if kind == "mat":
        return (float(u(0.4, 0.8)), float(u(0.6, 1.2)), 0.01), 1
    if kind == "planks":
        count = int(rng.integers(2, 8))
        return (count * float(u(0.15, 0.4)), float(u(0.8, 2.0)), 0.03), count
    if kind == "shelf":
        return (float(u(0.25, 0.45)), float(u(0.7, 1.6)), float(u(0.8, 2.0))), int(rng.integers(3, 8))
    if kind == "ramp":
        return (float(u(0.8, 2.5)), float(u(0.8, 1.5)), float(u(0.1, 0.7))), 1
    if kind == "fence":
        return (0.1, float(u(0.8, 2.2)), float(u(0.7, 1.4))), int(rng.integers(4, 11))
    if kind == "blinds":
        return (0.1, float(u(0.7, 1.6)), float(u(0.8, 2.0))), int(rng.integers(8, 19))
    if kind == "bench":
        return (float(u(0.3, 0.5)), float(u(0.9, 1.8)), float(u(0.35, 0.5))), 1
    if kind == "boxes":
        return (float(u(0.25, 0.6)), float(u(0.25, 0.6)), float(u(0.2, 0.5))), int(rng.integers(1, 5))
    return (float(u(0.2, 0.5)), 0.3, float(u(2.0, 2.6))), 1  # column


def _make(
    rng: np.random.Generator, kind: str, position: tuple[float, float, float], yaw_spread: float, yaw: float = 0.0
) -> DistractorSpec:
    size, count = _draw(rng, kind)
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
    if spec.kind == "ramp":
        length += 2.0
    if spec.kind == "boxes":
        width *= 1.0 + 1.15 * ((spec.count + 1) // 2)
    return 0.5 * math.hypot(length, width)


def draw_distractors(
    rng: np.random.Generator, stairs: StairSpec | None, surroundings: SurroundingsSpec, room: Enclosure, most: int = 4
) -> tuple[DistractorSpec, ...]:
    """One to `most` distractors where they are likely to be seen.

    Solid ones keep clear of the flight, of the way to it and of the way on; painted ones may lie in the way, but not
    on the flight. Without stairs they stand in the middle of the view.
    """
    if stairs is None:
        return _for_negative(rng, room, int(rng.integers(2, most + 2)))
    count = int(rng.integers(1, most + 1))
    found: list[DistractorSpec] = []
    for _ in range(count):
        where = rng.random()
        if where < 0.3:
            candidate = _in_the_way(rng, stairs)
        elif where < 0.6:
            candidate = _at_back_wall(rng, stairs, surroundings, room)
        else:
            candidate = _beside(rng, stairs, room)
        if candidate is not None:
            found.append(candidate)
    return tuple(found)


def _in_the_way(rng: np.random.Generator, stairs: StairSpec) -> DistractorSpec | None:
    """Paint on the floor before the first edge (up) or behind the last (down)."""
    profile = stairs.profile()
    made = _make(rng, FLAT_IN_WAY[int(rng.integers(len(FLAT_IN_WAY)))], (0.0, 0.0, 0.0), 0.08)
    reach = _radius(made) + 0.15
    if stairs.direction == "down":
        x = float(profile.edge_x[-1]) + reach + float(rng.uniform(0.0, 1.0))
    else:
        x = -reach - float(rng.uniform(0.0, 0.8))
    return DistractorSpec(
        made.kind, (x, float(rng.normal(0.0, 0.15)), 0.0), made.yaw_rad, made.size, made.count, made.seed, made.look
    )


def _at_back_wall(
    rng: np.random.Generator, stairs: StairSpec, surroundings: SurroundingsSpec, room: Enclosure
) -> DistractorSpec | None:
    """Furniture against the back wall, when there is room before it."""
    if surroundings.kind == "plain" or surroundings.back_gap < 0.7:
        return None
    made = _make(rng, WALL_KINDS[int(rng.integers(len(WALL_KINDS)))], (0.0, 0.0, 0.0), 0.02)
    side_room = (room.y_left - room.y_right) / 2 - _radius(made)
    if side_room <= 0.0:
        return None
    middle = (room.y_left + room.y_right) / 2
    position = (room.x_high - made.size[0] / 2 - 0.08, middle + float(rng.uniform(-1, 1)) * side_room, room.z_back)
    return DistractorSpec(made.kind, position, made.yaw_rad, made.size, made.count, made.seed, made.look)


def _beside(rng: np.random.Generator, stairs: StairSpec, room: Enclosure) -> DistractorSpec | None:
    """On the ground left or right of the flight."""
    half = stairs.flight_width / 2
    side = 1.0 if rng.random() < 0.5 else -1.0
    space = min((room.y_left - half) if side > 0 else (-half - room.y_right), 3.0)
    made = _make(rng, BESIDE_KINDS[int(rng.integers(len(BESIDE_KINDS)))], (0.0, 0.0, 0.0), 0.15)
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
    """Spread along the view, the nearest first, each further off than the one before."""
    found: list[DistractorSpec] = []
    x = float(rng.uniform(-0.6, 0.0))
    for _ in range(count):
        kind = NEGATIVE_KINDS[int(rng.integers(len(NEGATIVE_KINDS)))]
        made = _make(rng, kind, (0.0, 0.0, 0.0), 0.15)
        reach = _radius(made) if kind == "boxes" else made.size[0] / 2 + 0.15 + (0.9 if kind == "ramp" else 0.0)
        if x + 2 * reach > room.x_high:
            continue
        x += reach
        position = (x, float(np.clip(rng.normal(0.0, 0.3), -0.8, 0.8)), 0.0)
        found.append(DistractorSpec(made.kind, position, made.yaw_rad, made.size, made.count, made.seed, made.look))
        x += reach
    return tuple(found)
