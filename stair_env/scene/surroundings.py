"""What stands around a staircase, so that behind it there is more than the void: walls, a ceiling, an upper floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from stair_env.common.validation import check_choice, check_range
from stair_env.scene.shapes import FLOOR_MARGIN_M, START_DEPTH_M, WALL_THICKNESS_M, Shape, box_between
from stair_env.stairs import StairSpec

SurroundingsKind = Literal["plain", "indoor", "outdoor"]
WindowSide = Literal["none", "left", "right"]

SURROUNDINGS_KINDS: tuple[str, ...] = ("plain", "indoor", "outdoor")
WINDOW_SIDES: tuple[str, ...] = ("none", "left", "right")
PLAIN_DEPTH_M = 8.0  # of the upper floor when no wall ends it
SKIRTING_HEIGHT_M = 0.08
FAR_GROUND_M = 50.0
FAR_GROUND_DROP_M = 0.002
NEGATIVE_FLOOR_X_M = (-9.0, 9.0)  # floor of a scene without stairs
NEGATIVE_FLOOR_HALF_Y_M = 7.0


@dataclass(frozen=True)
class SurroundingsSpec:
    """The room or yard around a staircase, JSON-able and validated.

    Args:
        kind: "plain" (floors only), "indoor" (walls all round and a ceiling) or "outdoor" (a wall behind, perhaps
            walls beside, sky above).
        back_gap: from the end of the landing, or of the floor after the last edge, to the back wall, metres.
        left_gap, right_gap: from the flight's sides to the side walls, metres.
        headroom: from the highest floor to the ceiling or the walls' top, metres.
        window: side wall with an opening that lets the sun in (indoors).
        panels: doors, windows and pictures on the back wall.
        seed: of their arrangement.

    Raises:
        SpecError: a field is out of range.
    """

    kind: SurroundingsKind = "plain"
    back_gap: float = 1.0
    left_gap: float = 1.5
    right_gap: float = 1.5
    headroom: float = 2.6
    window: WindowSide = "none"
    panels: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        check_choice("kind", self.kind, SURROUNDINGS_KINDS)
        check_choice("window", self.window, WINDOW_SIDES)
        check_range("back_gap", self.back_gap, 0.0, 8.0)
        check_range("left_gap", self.left_gap, 0.0, 6.0)
        check_range("right_gap", self.right_gap, 0.0, 6.0)
        check_range("headroom", self.headroom, 2.0, 6.0)
        check_range("panels", self.panels, 0, 6)
        check_range("seed", self.seed, 0, 2**31 - 1)


@dataclass(frozen=True)
class Enclosure:
    """Inner faces of the walls and the heights between which they stand, metres, world frame."""

    x_low: float
    x_high: float
    y_right: float
    y_left: float
    z_back: float  # floor level at the back wall
    z_top: float


def enclosure(spec: SurroundingsSpec, stairs: StairSpec | None) -> Enclosure:
    """Where the walls are."""
    if stairs is None:
        return Enclosure(-8.0, 1.5 + spec.back_gap, -0.6 - spec.right_gap, 0.6 + spec.left_gap, 0.0, spec.headroom)
    profile = stairs.profile()
    last, half = float(profile.edge_x[-1]), stairs.flight_width / 2
    end = last + (stairs.landing_depth if stairs.direction == "up" else 1.0)
    return Enclosure(
        -START_DEPTH_M - FLOOR_MARGIN_M + WALL_THICKNESS_M,
        end + spec.back_gap,
        -half - spec.right_gap,
        half + spec.left_gap,
        float(profile.level_z[-1]),
        float(profile.level_z.max()) + spec.headroom,
    )


def build_surroundings(spec: SurroundingsSpec, stairs: StairSpec | None) -> tuple[Shape, ...]:
    """Every solid around the staircase, in the stair frame.

    Args:
        spec: what surrounds it.
        stairs: the staircase, or None for a scene without one (then a floor is part of the result).
    """
    room = enclosure(spec, stairs)
    shapes: list[Shape] = []
    if stairs is None:
        (x_low, x_high), half = NEGATIVE_FLOOR_X_M, NEGATIVE_FLOOR_HALF_Y_M
        shapes.append(box_between((x_low, -half, -0.5), (x_high, half, 0.0), "floor"))
    elif stairs.direction == "up":
        shapes.append(_upper_floor(spec, stairs, room))
    if spec.kind != "indoor":
        shapes.append(_far_ground())
    if spec.kind == "plain":
        return tuple(shapes)
    shapes.extend(_back_wall(room))
    shapes.extend(_side_walls(spec, room))
    if spec.kind == "indoor":
        shapes.append(
            box_between(
                (room.x_low, room.y_right, room.z_top),
                (room.x_high, room.y_left, room.z_top + WALL_THICKNESS_M),
                "ceiling",
            )
        )
        shapes.append(
            box_between(
                (room.x_low - WALL_THICKNESS_M, room.y_right, 0.0), (room.x_low, room.y_left, room.z_top), "wall"
            )
        )
    shapes.extend(_panels(spec, room))
    return tuple(shapes)


def _upper_floor(spec: SurroundingsSpec, stairs: StairSpec, room: Enclosure) -> Shape:
    """The landing goes on to the back wall, so that its far end is no edge that looks like another stair."""
    start = float(stairs.profile().edge_x[-1]) + stairs.landing_depth
    end = start + PLAIN_DEPTH_M if spec.kind == "plain" else room.x_high + WALL_THICKNESS_M
    half = stairs.flight_width / 2
    right, left = (-half, half) if spec.kind == "plain" else (room.y_right, room.y_left)
    return box_between((start, right, 0.0), (end, left, room.z_back), "floor")


def _far_ground() -> Shape:
    """Ground as far as the eye reaches, a hair's breadth below the floor that the stairs bring along."""
    far, top = FAR_GROUND_M, -FAR_GROUND_DROP_M
    return box_between((-far, -far, top - 0.5), (far, far, top), "floor")


def _back_wall(room: Enclosure) -> list[Shape]:
    """The wall and its skirting board."""
    x, right, left = room.x_high, room.y_right - WALL_THICKNESS_M, room.y_left + WALL_THICKNESS_M
    wall = box_between((x, right, 0.0), (x + WALL_THICKNESS_M, left, room.z_top), "wall")
    skirting = box_between(
        (x - 0.015, room.y_right, room.z_back), (x, room.y_left, room.z_back + SKIRTING_HEIGHT_M), "stringer"
    )
    return [wall, skirting]


def _side_walls(spec: SurroundingsSpec, room: Enclosure) -> list[Shape]:
    shapes: list[Shape] = []
    for side, gap, inner in (("left", spec.left_gap, room.y_left), ("right", spec.right_gap, room.y_right)):
        if spec.kind == "outdoor" and gap > 2.0:
            continue  # open to that side
        outer = inner + (WALL_THICKNESS_M if side == "left" else -WALL_THICKNESS_M)
        low, high = min(inner, outer), max(inner, outer)
        if spec.kind == "indoor" and spec.window == side:
            shapes.extend(_wall_with_window(spec, room, low, high))
        else:
            shapes.append(box_between((room.x_low, low, 0.0), (room.x_high, high, room.z_top), "wall"))
    return shapes


def _wall_with_window(spec: SurroundingsSpec, room: Enclosure, low: float, high: float) -> list[Shape]:
    """A side wall from four pieces around an opening above the flight."""
    rng = np.random.default_rng(spec.seed)
    width = float(rng.uniform(0.8, 2.4))
    left = float(rng.uniform(-1.5, max(-1.0, room.x_high - width - 0.5)))
    right = left + width
    sill = max(room.z_top - float(rng.uniform(1.4, 2.4)), 0.6)
    lintel = room.z_top - 0.3
    pieces = (
        ((room.x_low, 0.0), (left, room.z_top)),
        ((right, 0.0), (room.x_high, room.z_top)),
        ((left, 0.0), (right, sill)),
        ((left, lintel), (right, room.z_top)),
    )
    walls = [box_between((a[0], low, a[1]), (b[0], high, b[1]), "wall") for a, b in pieces]
    middle = (left + right) / 2
    bar = box_between((middle - 0.025, low, sill), (middle + 0.025, high, lintel), "rail")
    return [*walls, bar]


def _panels(spec: SurroundingsSpec, room: Enclosure) -> list[Shape]:
    """Doors (on the floor), windows and pictures (above it) on the back wall, never overlapping."""
    rng = np.random.default_rng(spec.seed + 1)
    width = room.y_left - room.y_right
    count = min(spec.panels, int(width / 1.1))
    shapes: list[Shape] = []
    for k in range(count):
        slot = width / count
        middle = room.y_right + (k + 0.5) * slot + float(rng.uniform(-0.5, 0.5)) * (slot - 1.1)
        door = rng.random() < 0.5
        half = 0.45 if door else float(rng.uniform(0.2, 0.5))
        low = room.z_back + (0.0 if door else float(rng.uniform(0.7, 1.1)))
        high = min(low + (2.0 if door else float(rng.uniform(0.5, 1.1))), room.z_top - 0.1)
        look = int(rng.integers(0, 3))  # painted or wooden, as palettes begin
        face, frame = f"distractor:panel:{look}", f"distractor:frame:{look + 1}"
        x = room.x_high
        shapes.append(box_between((x - 0.03, middle - half - 0.06, low), (x, middle + half + 0.06, high + 0.06), frame))
        shapes.append(
            box_between((x - 0.04, middle - half, low + (0.0 if door else 0.06)), (x, middle + half, high), face)
        )
    return shapes
