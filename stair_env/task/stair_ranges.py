"""From what staircases an episode draws its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stair_env.common.constants import EPISODE_DIRECTIONS, RISER_RANGE_M, STEP_COUNT_RANGE, TREAD_RANGE_M
from stair_env.common.validation import SpecError, as_range, check_choice, check_range
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
