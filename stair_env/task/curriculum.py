"""A curriculum over the riser height."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stair_env.common.constants import RISER_RANGE_M
from stair_env.common.validation import check_range, from_mapping


@dataclass(frozen=True)
class CurriculumConfig:
    """Raises the riser height as the policy succeeds.

    Attributes:
        start: riser of level 0, metres.
        levels: steps between `start` and the upper end of the environment's riser range.
        promote: success rate over the window that raises the level.
        demote: success rate that lowers it.
        window: episodes looked at.
        review: share of episodes drawn from any riser up to the level's, the rest are at the level.
    """

    start: float = 0.03
    levels: int = 14
    promote: float = 0.7
    demote: float = 0.2
    window: int = 10
    review: float = 0.3

    def __post_init__(self) -> None:
        check_range("curriculum.start", self.start, *RISER_RANGE_M)
        check_range("curriculum.levels", self.levels, 1, 1000)
        check_range("curriculum.promote", self.promote, 0.0, 1.0)
        check_range("curriculum.demote", self.demote, 0.0, self.promote)
        check_range("curriculum.window", self.window, 1, 1000)
        check_range("curriculum.review", self.review, 0.0, 1.0)


class Curriculum:
    """Level of one environment; `state` and `restore` make it checkpointable.

    Args:
        config: when to go up and down.
        highest: riser at the last level, metres.
    """

    def __init__(self, config: CurriculumConfig, highest: float) -> None:
        self.config = config
        self.highest = highest
        self.level = 0
        self._results: deque[bool] = deque(maxlen=config.window)

    @property
    def riser_height(self) -> float:
        """Riser of the current level, metres."""
        return self.config.start + (self.highest - self.config.start) * self.level / self.config.levels

    def report(self, success: bool) -> None:
        """Tell how an episode ended."""
        self._results.append(success)
        if len(self._results) < self.config.window:
            return
        rate = sum(self._results) / len(self._results)
        step = int(rate >= self.config.promote) - int(rate <= self.config.demote)
        level = min(max(self.level + step, 0), self.config.levels)
        if level != self.level:
            self.level = level
            self._results.clear()

    def draw_riser(self, lowest: float, rng: np.random.Generator) -> float:
        """Riser for the next episode, metres."""
        top = self.riser_height
        bottom = min(lowest, top, self.config.start)
        return float(rng.uniform(bottom, top)) if rng.random() < self.config.review else top

    def state(self) -> dict[str, Any]:
        """JSON-able state."""
        return {"level": self.level, "results": list(self._results)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from `state()`."""
        self.level = int(state["level"])
        self._results = deque((bool(result) for result in state["results"]), maxlen=self.config.window)


def read_curriculum(value: Any, highest: float) -> Curriculum | None:
    """None or False: none. True: the defaults. A mapping: the defaults with changes.

    Raises:
        SpecError: anything else, or a wrong field.
    """
    if value is None or value is False:
        return None
    config = CurriculumConfig() if value is True else from_mapping("curriculum", CurriculumConfig, value)
    return Curriculum(config, highest)
