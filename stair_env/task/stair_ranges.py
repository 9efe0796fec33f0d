"""From what staircases an episode draws its own: ranges, or a sampler of one's own."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from stair_env.common.constants import EPISODE_DIRECTIONS, RISER_RANGE_M, STEP_COUNT_RANGE, TREAD_RANGE_M
from stair_env.common.field_kinds import naming_fields
from stair_env.common.validation import SpecError, as_range, check_choice, check_range, has_parts
from stair_env.sampling import SceneSpec
from stair_env.stairs import StairSpec
from stair_env.task.curriculum import Curriculum

Range = tuple[float, float]


@dataclass(frozen=True)
class StairRanges:
    """From what staircases are drawn.

    Attributes:
        direction: "up", "down" or "both" (a coin decides).
        riser_height, tread_depth: metres, low and high.
        num_steps: low and high, inclusive.
        flight_width: metres.
        uneven: largest deviation of single risers and treads, metres.
    """

    direction: str = "up"
    riser_height: Range = (0.10, 0.17)
    tread_depth: Range = (0.26, 0.34)
    num_steps: Range = (4, 7)
    flight_width: float = 1.2
    uneven: float = 0.0

    @naming_fields
    def __post_init__(self) -> None:
        check_choice("direction", self.direction, EPISODE_DIRECTIONS)
        object.__setattr__(self, "riser_height", as_range("riser_height", self.riser_height, *RISER_RANGE_M))
        object.__setattr__(self, "tread_depth", as_range("tread_depth", self.tread_depth, *TREAD_RANGE_M))
        steps = as_range("num_steps", self.num_steps, *STEP_COUNT_RANGE)
        if any(count != int(count) for count in steps):
            raise SpecError(f"num_steps={self.num_steps!r} must be whole numbers")
        object.__setattr__(self, "num_steps", steps)
        check_range("flight_width", self.flight_width, 0.6, 6.0)
        check_range("uneven", self.uneven, 0.0, 0.03)

    def draw(self, rng: np.random.Generator, curriculum: Curriculum | None) -> StairSpec:
        """One staircase."""
        coin = rng.random() < 0.5
        direction = self.direction if self.direction != "both" else ("up" if coin else "down")
        riser = float(rng.uniform(*self.riser_height))
        if curriculum is not None:
            riser = curriculum.draw_riser(self.riser_height[0], rng)
        steps = int(rng.integers(int(self.num_steps[0]), int(self.num_steps[1]) + 1))
        tread = float(rng.uniform(*self.tread_depth))
        offsets = np.round(rng.uniform(-self.uneven, self.uneven, (2, steps)), 4)
        return StairSpec(
            direction=direction,  # type: ignore[arg-type]
            riser_height=riser,
            tread_depth=tread,
            num_steps=steps,
            flight_width=self.flight_width,
            riser_offsets=tuple(offsets[0]) if self.uneven else (),
            tread_offsets=tuple(offsets[1]) if self.uneven else (),
        )


class StairSampler(Protocol):
    """Draws the staircase, or the whole scene, of each episode."""

    def sample(self, rng: np.random.Generator) -> StairSpec | SceneSpec:
        """Return a staircase, or a scene with stairs, all of whose solids the robot can bump into.

        Args:
            rng: the environment's; every random draw comes from it.
        """


def read_sampler(sampler: Any, curriculum: Curriculum | None) -> StairSampler | None:
    """Check a sampler and copy it; None stands for the environment's ranges.

    Raises:
        SpecError: it has no `sample`, or there is a curriculum, which raises the risers of the ranges only.
    """
    if sampler is None:
        return None
    if not has_parts(sampler, ("sample",)):
        raise SpecError(f"sampler={sampler!r} must be None or an object with sample(rng), for example a SceneSampler")
    if curriculum is not None:
        raise SpecError(f"sampler={sampler!r} leaves a curriculum nothing to draw: use one of them")
    copied: StairSampler = copy.deepcopy(sampler)
    return copied


def draw_sampled(sampler: StairSampler, rng: np.random.Generator) -> tuple[StairSpec, SceneSpec | None]:
    """Return a sampler's staircase and, if it drew one, the scene around it.

    Raises:
        SpecError: what it drew is neither a StairSpec nor a SceneSpec with stairs.
    """
    drawn = sampler.sample(rng)
    if isinstance(drawn, StairSpec):
        return drawn, None
    if isinstance(drawn, SceneSpec) and drawn.stairs is not None:
        return drawn.stairs, drawn
    raise SpecError(f"sampler={sampler!r} drew {drawn!r}, must draw a StairSpec or a SceneSpec with stairs")
