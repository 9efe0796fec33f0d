"""What is fitted to a flight: balustrades, rails on walls, skirting, a runner, the flight above.

Only drawn, never walked on: the physics builds the stairs from `stair_env.scene.build_stair_shapes` alone.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stair_env.common.validation import check_choice, check_range
from stair_env.scene.shapes import RAIL_HEIGHT_M, RAIL_RADIUS_M, Shape, Vector3, box_between
from stair_env.stairs import StairSpec

Railing = Literal["none", "bars", "cross_bars", "panel"]
Sides = Literal["none", "left", "right", "both"]

RAILINGS: tuple[str, ...] = ("none", "bars", "cross_bars", "panel")
SIDES: tuple[str, ...] = ("none", "left", "right", "both")
MOST_BARS = 40  # a side and flight: a renderer pays for each
BAR_M = 0.008  # half thickness
RUNNER_THICKNESS_M = 0.004
SKIRTING_THICKNESS_M = 0.012
SKIRTING_ABOVE_M = 0.05  # the line of the nosings, at right angles to it
BELOW_M = 0.3
SOFFIT_CLEARANCE_M = 2.2
BRACKET_EVERY_M = 1.2


@dataclass(frozen=True)
class FittingsSpec:
    """What is fitted to a flight, JSON-able and validated.

    Args:
        railing: what fills a balustrade: upright bars, bars along the slope, or a panel.
        railing_sides: sides with a balustrade.
        bar_spacing_m: from bar to bar, metres.
        wall_sides: sides with a wall, which get the next two.
        wall_rail: a handrail on brackets.
        skirting: a board along the foot of the wall that follows the slope.
        runner: share of the flight's width that a carpet covers, 0 for none.
        soffit: the underside of a flight above.
        look: of the balustrade, index into the appearance's palette of distractors.
        runner_look: of the carpet.

    Raises:
        SpecError: a field is out of range.
    """

    railing: Railing = "none"
    railing_sides: Sides = "none"
    bar_spacing_m: float = 0.12
    wall_sides: Sides = "none"
    wall_rail: bool = False
    skirting: bool = False
    runner: float = 0.0
    soffit: bool = False
    look: int = 4
    runner_look: int = 6

    def __post_init__(self) -> None:
        check_choice("railing", self.railing, RAILINGS)
        check_choice("railing_sides", self.railing_sides, SIDES)
        check_range("bar_spacing_m", self.bar_spacing_m, 0.05, 1.5)
        check_choice("wall_sides", self.wall_sides, SIDES)
        check_range("runner", self.runner, 0.0, 1.0)
        check_range("look", self.look, 0, 255)
        check_range("runner_look", self.runner_look, 0, 255)


@dataclass(frozen=True)
class _Flight:
    """The line of the nosings of one flight, from x0, z0 to x1, z1, metres."""

    x0: float
    z0: float
    x1: float
    z1: float

    @property
    def length(self) -> float:
        return math.hypot(self.x1 - self.x0, self.z1 - self.z0)

    @property
    def pitch(self) -> float:
        """Turn about y that lays x along the slope."""
        return -math.atan2(self.z1 - self.z0, self.x1 - self.x0)

    def height_at(self, x: float) -> float:
        """Of the line, metres."""
        return self.z0 + (self.z1 - self.z0) * (x - self.x0) / (self.x1 - self.x0)

    def beam(self, y: float, half_y: float, low: float, high: float, surface: str, ends: float = 0.0) -> Shape:
        """Box along the slope from `low` to `high` at right angles above the line."""
        cos, sin = math.cos(self.pitch), math.sin(self.pitch)
        up = (low + high) / 2
        centre = ((self.x0 + self.x1) / 2 + up * sin, y, (self.z0 + self.z1) / 2 + up * cos)
        orientation = (0.0, math.sin(self.pitch / 2), 0.0, math.cos(self.pitch / 2))
        return Shape("box", centre, (self.length / 2 + ends, half_y, (high - low) / 2), orientation, surface)


def _flights(stairs: StairSpec) -> list[_Flight]:
    profile, n = stairs.profile(), stairs.num_steps
    if n < 2:
        return []
    found = []
    for first in (0,) if stairs.direction != "up_down" else (0, n):
        ends = (first, first + n - 1)
        x0, x1 = (float(profile.edge_x[k]) for k in ends)
        z0, z1 = (float(max(profile.level_z[k], profile.level_z[k + 1])) for k in ends)
        found.append(_Flight(x0, z0, x1, z1))
    return found


def _signs(sides: str) -> tuple[float, ...]:
    return {"none": (), "left": (1.0,), "right": (-1.0,), "both": (1.0, -1.0)}[sides]


def build_fittings(spec: FittingsSpec, stairs: StairSpec) -> tuple[Shape, ...]:
    """Every solid fitted to the flights, in the stair frame."""
    half = stairs.flight_width / 2
    shapes: list[Shape] = []
    for flight in _flights(stairs):
        for side in _signs(spec.railing_sides) if spec.railing != "none" else ():
            shapes.extend(_balustrade(spec, flight, side * (half + 2 * RAIL_RADIUS_M)))
        for side in _signs(spec.wall_sides):
            if spec.skirting:
                y = side * (half - SKIRTING_THICKNESS_M / 2)
                board = (y, SKIRTING_THICKNESS_M / 2, -BELOW_M, SKIRTING_ABOVE_M)
                shapes.append(flight.beam(*board, "stringer", ends=0.1))
            if spec.wall_rail:
                shapes.extend(_wall_rail(flight, side, half))
        if spec.soffit:
            low = SOFFIT_CLEARANCE_M * math.cos(flight.pitch)
            shapes.append(flight.beam(0.0, half, low, low + 0.2, "ceiling", ends=0.5))
    if spec.runner > 0.0 and not stairs.open_risers:
        shapes.extend(_runner(spec, stairs))
    return tuple(dataclasses.replace(shape, collides=False) for shape in shapes)


def _balustrade(spec: FittingsSpec, flight: _Flight, y: float) -> list[Shape]:
    """A handrail, a rail at the foot and what fills the room between them."""
    surface = f"distractor:railing:{spec.look}"
    top = RAIL_HEIGHT_M * math.cos(flight.pitch)
    shapes = [
        flight.beam(y, 0.025, top - 0.02, top + 0.02, "rail", ends=0.05),
        flight.beam(y, 0.015, 0.04, 0.08, surface),
    ]
    if spec.railing == "panel":
        shapes.append(flight.beam(y, 0.008, 0.1, top - 0.05, surface))
    if spec.railing == "cross_bars":
        for level in np.arange(0.08 + spec.bar_spacing_m, top - 0.04, spec.bar_spacing_m).tolist():
            shapes.append(flight.beam(y, BAR_M, level - BAR_M, level + BAR_M, surface))
    run = flight.x1 - flight.x0
    spacing = max(spec.bar_spacing_m, run / MOST_BARS) if spec.railing == "bars" else max(run / 2, 0.1)
    for x in np.linspace(flight.x0, flight.x1, max(2, round(run / spacing) + 1)).tolist():
        z = flight.height_at(x)
        shapes.append(box_between((x - BAR_M, y - BAR_M, z - 0.1), (x + BAR_M, y + BAR_M, z + RAIL_HEIGHT_M), surface))
    return shapes


def _wall_rail(flight: _Flight, side: float, half: float) -> list[Shape]:
    """A round rail before the wall, on brackets."""
    y = side * (half - 0.06)
    up = RAIL_HEIGHT_M * math.cos(flight.pitch)
    rail = flight.beam(y, RAIL_RADIUS_M, up - RAIL_RADIUS_M, up + RAIL_RADIUS_M, "rail", ends=0.15)
    # A beam's x axis runs along the slope; a cylinder's own axis is z: another quarter turn.
    turn = flight.pitch + math.pi / 2
    shapes = [
        Shape(
            "cylinder",
            rail.position,
            (RAIL_RADIUS_M, flight.length / 2 + 0.15, 0.0),
            (0.0, math.sin(turn / 2), 0.0, math.cos(turn / 2)),
            "rail",
        )
    ]
    count = max(2, round((flight.x1 - flight.x0) / BRACKET_EVERY_M) + 1)
    for x in np.linspace(flight.x0, flight.x1, count).tolist():
        z = flight.height_at(x) + RAIL_HEIGHT_M
        low, high = sorted((y, side * half))
        shapes.append(box_between((x - 0.008, low, z - 0.05), (x + 0.008, high, z - 0.03), "rail"))
    return shapes


def _runner(spec: FittingsSpec, stairs: StairSpec) -> list[Shape]:
    """A thin carpet over every tread and riser, in the middle of the flight."""
    profile, half = stairs.profile(), spec.runner * stairs.flight_width / 2
    surface, thick = f"distractor:runner:{spec.runner_look}", RUNNER_THICKNESS_M
    shapes = []
    for k, (x, rise) in enumerate(zip(profile.edge_x.tolist(), profile.rises.tolist())):
        out = -1.0 if rise > 0 else 1.0  # from the riser into the open
        high, low = max(profile.level_z[k], profile.level_z[k + 1]), min(profile.level_z[k], profile.level_z[k + 1])
        near, far = sorted((x, x + out * thick))
        shapes.append(box_between((near, -half, float(low)), (far, half, float(high) + thick), surface))
        if k + 1 < len(profile.edge_x) and abs(float(profile.edge_x[k + 1]) - x) < 2 * stairs.tread_depth:
            corners: tuple[Vector3, Vector3] = (
                (x, -half, float(profile.level_z[k + 1])),
                (float(profile.edge_x[k + 1]), half, float(profile.level_z[k + 1]) + thick),
            )
            shapes.append(box_between(*corners, surface))
    return shapes


def draw_fittings(rng: np.random.Generator, stairs: StairSpec, walls: Sides, rich: bool) -> FittingsSpec:
    """Random fittings.

    Args:
        rng: the source of all chance.
        stairs: the staircase.
        walls: sides on which a wall stands right beside the flight.
        rich: whether to fit what has many parts.
    """
    free = {"none": "both", "left": "right", "right": "left", "both": "none"}[walls]
    kind = RAILINGS[int(rng.choice(4, p=(0.45, 0.3, 0.12, 0.13)))] if rich and not stairs.handrails else "none"
    one_side = free == "both" and rng.random() < 0.4
    sides = (SIDES[1 + int(rng.integers(2))]) if one_side else free
    runner = float(rng.uniform(0.5, 0.95)) if rich and stairs.nosing_overhang == 0.0 and rng.random() < 0.1 else 0.0
    return FittingsSpec(
        railing=kind,  # type: ignore[arg-type]
        railing_sides=sides,  # type: ignore[arg-type]
        bar_spacing_m=float(rng.uniform(0.08, 0.2)),
        wall_sides=walls,
        wall_rail=bool(rng.random() < 0.5),
        skirting=bool(rng.random() < 0.5),
        runner=runner,
        soffit=bool(rich and rng.random() < 0.15),
        look=int(rng.integers(6)),
        runner_look=int(rng.choice([6, 7, 12])),
    )
