"""What goes wrong between planner and motors: commands that come late, and pushes."""

from __future__ import annotations

import math

import numpy as np


class CommandLatency:
    """Delivers joint targets, now and then those of the control step before.

    Args:
        chance: probability that a control step's command arrives one step late, 0 to 1.
    """

    def __init__(self, chance: float) -> None:
        self._chance = chance

    def reset(self, targets: np.ndarray, rng: np.random.Generator) -> None:
        """Begin an episode.

        Args:
            targets: (12,) joint angles that the motors hold, radians.
            rng: draws at each control step, unless the chance is zero.
        """
        self._planned, self._rng = targets, rng

    def deliver(self, targets: np.ndarray) -> np.ndarray:
        """Return what reaches the motors of newly planned (12,) joint targets, radians."""
        late = self._chance and self._rng.random() < self._chance
        delivered = self._planned if late else targets
        self._planned = targets
        return delivered


class Pushes:
    """Sudden horizontal changes of the trunk's velocity at random times.

    Args:
        speed_m_s: largest change along each axis.
        interval_s: mean time between pushes; 0 means none.
    """

    def __init__(self, speed_m_s: float, interval_s: float) -> None:
        self._speed_m_s, self._interval_s = speed_m_s, interval_s

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode and draw when the first push comes."""
        self._rng = rng
        self._next_s = self._draw_time(0.0)

    def due(self, time_s: float) -> np.ndarray | None:
        """Return the push that has come due, (3,) world frame, m/s, and draw the next one's time."""
        if time_s < self._next_s:
            return None
        push = np.append(self._rng.uniform(-1, 1, 2) * self._speed_m_s, 0.0)
        self._next_s = self._draw_time(time_s)
        return push

    def _draw_time(self, now_s: float) -> float:
        return now_s + float(self._rng.exponential(self._interval_s)) if self._interval_s else math.inf
