"""Random scenes: one sampler draws stairs, materials, light, surroundings and distractors from one generator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stair_env.common.constants import (
    LIGHTING_CHOICES,
    RISER_RANGE_M,
    SCENE_DIRECTIONS,
    STEP_COUNT_RANGE,
    TREAD_RANGE_M,
)
from stair_env.common.field_kinds import naming_fields
from stair_env.common.validation import SpecError, as_range, check_choice, check_range
from stair_env.scene.appearance import AppearanceSpec, Lighting
from stair_env.scene.objects.fittings import draw_fittings
from stair_env.scene.random_appearance import automatic_exposure, draw_light, draw_materials
from stair_env.scene.random_distractors import draw_distractors, draw_obstacles
from stair_env.scene.random_marks import draw_marks
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.scene.surroundings import SurroundingsKind, SurroundingsSpec, WindowSide, enclosure
from stair_env.scene.viewpoints import sample_camera_pose
from stair_env.stairs import Direction, SideWalls, StairSpec

__all__ = ["Scene", "SceneSampler", "SceneSpec", "sample_camera_pose"]

DIRECTION_CHOICES: dict[str, tuple[Direction, ...]] = {
    "up": ("up",),
    "down": ("down",),
    "up_down": ("up_down",),
    "both": ("up", "down"),
    "any": ("up", "down", "up", "down", "up_down"),
}
UNEVEN_SHARE = 0.4
UNEVEN_STD_M = 0.004  # building codes allow about 5 mm between neighbouring steps; old stairs exceed it
UNEVEN_LIMIT_M = 0.012
OVERHANG_SHARE = 0.4
OVERHANG_M = (0.005, 0.030)
OPEN_RISER_SHARE = 0.08
STAIRWELL_SHARE = 0.25  # of the rooms have walls right beside the flight on both sides
SURROUNDINGS_SHARES: dict[SurroundingsKind, float] = {"indoor": 0.55, "outdoor": 0.3, "plain": 0.15}

Span = float | tuple[float, float]


@dataclass(frozen=True)
class SceneSampler:
    """Draws SceneSpecs.

    Args:
        riser_height, tread_depth: one number or (low, high), metres.
        num_steps: one number or (low, high), both included.
        direction: "up", "down", "up_down", "both" (up or down) or "any" (all three).
        lighting: "day", "night" or "random".
        negatives: share of scenes without stairs, 0 to 1.
        distractors: whether there are things that look like stairs (negatives always have some).
        surroundings: whether there are walls and ceilings.
        details: whether stairs vary beyond riser and tread: uneven steps, nosings, open risers, walls, rails.
        clutter: share of scenes with people and things on the flight or right before it, 0 to 1. Above 0 there are also
            railings with balusters and furniture of many parts. For data sets: no robot could walk there, and frames
            take longer to draw.

    Raises:
        SpecError: an argument is out of range.
    """

    riser_height: Span = (0.05, 0.20)
    tread_depth: Span = (0.22, 0.40)
    num_steps: int | tuple[int, int] = (2, 12)
    direction: str = "any"
    lighting: Literal["day", "night", "random"] = "random"
    negatives: float = 0.0
    distractors: bool = True
    surroundings: bool = True
    details: bool = True
    clutter: float = 0.0

    @naming_fields
    def __post_init__(self) -> None:
        object.__setattr__(self, "riser_height", as_range("riser_height", self.riser_height, *RISER_RANGE_M))
        object.__setattr__(self, "tread_depth", as_range("tread_depth", self.tread_depth, *TREAD_RANGE_M))
        steps = as_range("num_steps", self.num_steps, *STEP_COUNT_RANGE)
        if any(end != int(end) for end in steps):
            raise SpecError(f"num_steps={self.num_steps!r} must be whole numbers")
        object.__setattr__(self, "num_steps", (int(steps[0]), int(steps[1])))
        check_choice("direction", self.direction, SCENE_DIRECTIONS)
        check_choice("lighting", self.lighting, LIGHTING_CHOICES)
        check_range("negatives", self.negatives, 0.0, 1.0)
        check_range("clutter", self.clutter, 0.0, 1.0)

    def sample(self, rng: np.random.Generator) -> SceneSpec:
        """A scene; the same generator state gives the same scene."""
        stairs = None if rng.random() < self.negatives else self.sample_stairs(rng)
        return self.sample_around(stairs, rng)

    def sample_around(self, stairs: StairSpec | None, rng: np.random.Generator) -> SceneSpec:
        """Everything else of a scene, around given stairs (None: a scene without)."""
        around = self._sample_surroundings(rng, stairs)
        room = enclosure(around, stairs)
        lighting: Lighting = self._sample_lighting(rng)
        look = draw_materials(rng, around.kind == "indoor", strips=self.details)
        light = draw_light(rng, lighting, around, room, stairs, automatic_exposure(look))
        wanted = stairs is None or (self.distractors and rng.random() < 0.7)
        crowded = self.clutter > 0.0
        things = draw_distractors(rng, stairs, around, room, crowded=crowded) if wanted else ()
        if stairs is not None and rng.random() < self.clutter:
            things += draw_obstacles(rng, stairs)
        marks = draw_marks(rng, light, around, stairs)
        fittings = None
        if stairs is not None and self.details:
            fittings = draw_fittings(rng, stairs, _walls_beside(stairs, around), crowded)
        return SceneSpec(stairs, AppearanceSpec(**look, **light, **marks), things, around, fittings)

    def _sample_lighting(self, rng: np.random.Generator) -> Lighting:
        if self.lighting != "random":
            return self.lighting
        return "day" if rng.random() < 0.5 else "night"

    def sample_stairs(self, rng: np.random.Generator) -> StairSpec:
        """A staircase alone."""
        riser, tread = float(rng.uniform(*self.riser_height)), float(rng.uniform(*self.tread_depth))  # type: ignore[misc]
        low, high = self.num_steps  # type: ignore[misc]
        count = int(rng.integers(low, high + 1))
        direction: Direction = self._sample_direction(rng)
        if not self.details:
            return StairSpec(direction, riser, tread, count)
        uneven = rng.random() < UNEVEN_SHARE
        width = float(np.exp(rng.normal(math.log(1.3), 0.3)))
        return StairSpec(
            direction=direction,
            riser_height=riser,
            tread_depth=tread,
            num_steps=count,
            flight_width=float(np.clip(width, 0.8, 3.0)),
            landing_depth=float(rng.uniform(1.0, 2.5)),
            riser_offsets=_offsets(rng, count, min(UNEVEN_LIMIT_M, 0.3 * riser)) if uneven else (),
            tread_offsets=_offsets(rng, count, UNEVEN_LIMIT_M) if uneven else (),
            nosing_overhang=float(rng.uniform(*OVERHANG_M)) if rng.random() < OVERHANG_SHARE else 0.0,
            open_risers=bool(rng.random() < OPEN_RISER_SHARE),
            side_walls=_side_walls(rng),
            handrails=bool(rng.random() < 0.4),
            stringers=bool(rng.random() < 0.25),
        )

    def _sample_direction(self, rng: np.random.Generator) -> Direction:
        choices = DIRECTION_CHOICES[self.direction]
        return choices[int(rng.integers(len(choices)))]

    def _sample_surroundings(self, rng: np.random.Generator, stairs: StairSpec | None) -> SurroundingsSpec:
        if not self.surroundings:
            return SurroundingsSpec()
        kinds = tuple(SURROUNDINGS_SHARES)
        kind = kinds[int(rng.choice(len(kinds), p=list(SURROUNDINGS_SHARES.values())))]
        reach = 2.0 if kind == "indoor" else 5.0
        stairwell = kind == "indoor" and rng.random() < STAIRWELL_SHARE
        gaps = [0.0 if stairwell or rng.random() < 0.25 else float(rng.uniform(0.3, reach)) for _ in range(2)]
        if stairs is None:
            gaps = [max(gap, 0.8) for gap in gaps]
        window: WindowSide = "none"
        if kind == "indoor" and rng.random() < 0.4:
            window = "left" if rng.random() < 0.5 else "right"
        return SurroundingsSpec(
            kind=kind,
            back_gap=float(rng.uniform(0.0, 3.0)) + (1.0 if stairs is None else 0.0),
            left_gap=gaps[0],
            right_gap=gaps[1],
            headroom=float(rng.uniform(2.2, 3.2)),
            window=window,
            panels=int(rng.integers(0, 4)),
            seed=int(rng.integers(2**30)),
        )


def _offsets(rng: np.random.Generator, count: int, limit: float) -> tuple[float, ...]:
    """Deviations of the steps from nominal, metres."""
    return tuple(float(value) for value in np.clip(rng.normal(0.0, UNEVEN_STD_M, count), -limit, limit))


def _walls_beside(stairs: StairSpec, around: SurroundingsSpec) -> SideWalls:
    """Sides on which a wall stands right beside the flight: its own, or the room's."""
    left, right = (
        stairs.side_walls in (side, "both") or (around.kind == "indoor" and gap == 0.0)
        for side, gap in (("left", around.left_gap), ("right", around.right_gap))
    )
    return "both" if left and right else "left" if left else "right" if right else "none"


def _side_walls(rng: np.random.Generator) -> SideWalls:
    options: tuple[SideWalls, ...] = ("none", "none", "none", "left", "right", "both")
    return options[int(rng.integers(len(options)))]
