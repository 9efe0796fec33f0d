"""Staircase geometry: what is built, before it looks like anything.

The world frame *is* the stair frame: x runs along the walking direction, y to the left, z up. The first stair edge
of a flight lies at x = 0, the middle of the flight at y = 0, and the lowest floor at z = 0. A robot that approaches
at an angle is spawned at an angle; the stairs never turn.

Two words for each length are used throughout: the *tread depth* of builders is the *step width* of the StairNetV2
paper, the *riser height* is its *step height*.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from stair_env.common.constants import RISER_RANGE_M, STAIRCASE_DIRECTIONS, STEP_COUNT_RANGE, TREAD_RANGE_M
from stair_env.common.validation import JsonSpec, SpecError, check_choice, check_range

Direction = Literal["up", "down", "up_down"]
WalkingDirection = Literal["up", "down"]
EdgeKind = Literal["convex", "concave"]
SideWalls = Literal["none", "left", "right", "both"]

SIDE_WALLS: tuple[str, ...] = ("none", "left", "right", "both")
MAX_NOSING_OVERHANG_M = 0.05


@dataclass(frozen=True)
class StairEdge:
    """One straight stair line in the stair frame, across the whole flight width.

    Attributes:
        kind: "convex" for a nosing (paper class 0), "concave" for an inner edge (class 1).
        x, z: position of the line, metres.
        y_right, y_left: lateral ends, metres (y_right < y_left).
        step: index of the transition it belongs to, counted along the walking direction from 0.
    """

    kind: EdgeKind
    x: float
    z: float
    y_right: float
    y_left: float
    step: int

    @property
    def endpoints(self) -> np.ndarray:
        """(2, 3) float64 end points in the stair frame, left end first as seen when walking in +x."""
        return np.array([[self.x, self.y_left, self.z], [self.x, self.y_right, self.z]])


@dataclass(frozen=True)
class StairProfile:
    """Side view of a staircase as a step function z(x).

    Attributes:
        edge_x: (n,) x of each vertical transition, ascending order, metres.
        level_z: (n + 1,) walking level before the first, between, and after the last transition, metres.
    """

    edge_x: np.ndarray
    level_z: np.ndarray

    def height_at(self, x: np.ndarray | float) -> np.ndarray:
        """Walking-surface height at x (any shape), metres."""
        return self.level_z[np.searchsorted(self.edge_x, x, side="right")]

    @cached_property
    def plain(self) -> tuple[list[float], list[float]]:
        """`edge_x` and `level_z` as lists, which are several times as fast where one number is asked for at a time."""
        return self.edge_x.tolist(), self.level_z.tolist()

    @property
    def rises(self) -> np.ndarray:
        """(n,) signed height change at each transition; positive is up."""
        return np.diff(self.level_z)


@dataclass(frozen=True)
class StairSpec(JsonSpec):
    """A staircase, JSON-able and validated.

    Args:
        direction: "up" or "down" one flight, or "up_down": up, across a landing, down.
        riser_height: nominal rise of a step (paper: step height), metres.
        tread_depth: nominal run of a step (paper: step width), metres.
        num_steps: number of rises in a flight.
        flight_width: lateral extent, metres.
        landing_depth: depth of the platform at the end of a flight (the one between two flights for
            "up_down"), metres.
        riser_offsets: signed deviation of each rise from nominal, metres; empty or num_steps long.
        tread_offsets: signed deviation of each run from nominal, metres; empty or num_steps long.
        nosing_overhang: how far a tread reaches over the riser below it, metres.
        open_risers: treads are slabs with nothing between them.
        side_walls: walls along the flight.
        handrails: rails on posts along both sides that have no wall.
        stringers: boards along the sides of the flight.

    Raises:
        SpecError: a field is out of range (a ValueError).
    """

    direction: Direction = "up"
    riser_height: float = 0.15
    tread_depth: float = 0.30
    num_steps: int = 6
    flight_width: float = 1.2
    landing_depth: float = 1.6
    riser_offsets: tuple[float, ...] = ()
    tread_offsets: tuple[float, ...] = ()
    nosing_overhang: float = 0.0
    open_risers: bool = False
    side_walls: SideWalls = "none"
    handrails: bool = False
    stringers: bool = False

    def __post_init__(self) -> None:
        check_choice("direction", self.direction, STAIRCASE_DIRECTIONS)
        check_range("riser_height", self.riser_height, *RISER_RANGE_M)
        check_range("tread_depth", self.tread_depth, *TREAD_RANGE_M)
        if isinstance(self.num_steps, bool) or not isinstance(self.num_steps, (int, np.integer)):
            raise SpecError(f"num_steps={self.num_steps!r} must be a whole number")
        check_range("num_steps", self.num_steps, *STEP_COUNT_RANGE)
        check_range("flight_width", self.flight_width, 0.5, 6.0)
        check_range("landing_depth", self.landing_depth, 0.6, 10.0)
        check_range("nosing_overhang", self.nosing_overhang, 0.0, MAX_NOSING_OVERHANG_M)
        check_choice("side_walls", self.side_walls, SIDE_WALLS)
        for name in ("riser_offsets", "tread_offsets"):
            given = getattr(self, name)
            if not isinstance(given, (tuple, list, np.ndarray)):
                raise SpecError(f"{name}={given!r} must be a sequence of numbers, metres")
            for value in given:
                check_range(name, value, -0.05, 0.05)
            offsets = tuple(float(value) for value in given)
            object.__setattr__(self, name, offsets)
            if len(offsets) not in (0, self.num_steps):
                raise SpecError(f"{name} has {len(offsets)} values, must have 0 or num_steps={self.num_steps}")
        if min(self._rises()) <= 0.0:
            raise SpecError(f"riser_offsets={self.riser_offsets!r} leave a step without height")

    def _rises(self) -> np.ndarray:
        offsets = np.asarray(self.riser_offsets) if self.riser_offsets else 0.0
        return np.full(self.num_steps, float(self.riser_height)) + offsets

    def _runs(self) -> np.ndarray:
        offsets = np.asarray(self.tread_offsets) if self.tread_offsets else 0.0
        return np.full(self.num_steps, float(self.tread_depth)) + offsets

    @property
    def total_height(self) -> float:
        """Height between the floors of one flight, metres."""
        return float(self._rises().sum())

    @property
    def slope_rad(self) -> float:
        """Nominal pitch of the flight, radians, positive for both directions."""
        return math.atan2(self.riser_height, self.tread_depth)

    def profile(self) -> StairProfile:
        """The side view along the walking direction; levels start at the floor on which a robot spawns."""
        # The run of a flight's last step is the landing, so num_steps rises need num_steps - 1 runs.
        up_x = np.concatenate([[0.0], np.cumsum(self._runs()[:-1])])
        up_z = np.concatenate([[0.0], np.cumsum(self._rises())])
        if self.direction == "up":
            return StairProfile(up_x, up_z)
        if self.direction == "down":
            return StairProfile(up_x, up_z[-1] - up_z)
        down_x = up_x[-1] + self.landing_depth + up_x
        return StairProfile(np.concatenate([up_x, down_x]), np.concatenate([up_z, up_z[-1] - up_z[1:]]))

    def edges(self) -> tuple[StairEdge, ...]:
        """Every nosing and inner edge; with open risers there are no inner edges.

        The nosing of a transition lies at the profile's x. The inner edge lies at the riser's foot, which an
        overhanging nosing hides further inside.
        """
        profile, half = self.profile(), self.flight_width / 2
        found: list[StairEdge] = []
        for step, (x, rise) in enumerate(zip(profile.edge_x, profile.rises)):
            low, high = sorted(profile.level_z[step : step + 2])
            riser_x = x + math.copysign(self.nosing_overhang, rise)
            found.append(StairEdge("convex", float(x), float(high), -half, half, step))
            if not self.open_risers:
                found.append(StairEdge("concave", float(riser_x), float(low), -half, half, step))
        return tuple(found)
