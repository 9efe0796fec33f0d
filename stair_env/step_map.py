"""What the gait remembers of the stairs: a strip of edges ahead of and behind the base.

The map is one-dimensional, along the walking direction of the stairs, and moves with the robot: s = 0 is the base,
positive s lies ahead. It is filled from the stair block alone and remembers the edges the front feet have passed,
because the rear feet still have to climb them.
"""

from __future__ import annotations

import numpy as np

from stair_env.observation import StairBlock

FORGET_BEHIND_M = 1.5
LOST_AFTER_S = 1.5  # an edge ahead that nobody confirms for so long is dropped


class StepMap:
    """Edges around the robot as positions and signed rises."""

    def __init__(self) -> None:
        self.reset()

    def reset(self, level: float = 0.0) -> None:
        """Forget everything.

        Args:
            level: height of the ground, metres.
        """
        self._passed_s: list[float] = []
        self._passed_rise: list[float] = []
        self._next_s: float | None = None
        self._next_rise = 0.0
        self._tread = 0.3
        self._level_behind = level  # of the ground before the first remembered edge
        self._unconfirmed_s = 0.0
        self._extends = False

    @property
    def knows_stairs(self) -> bool:
        """Whether any edge is remembered or expected."""
        return self._next_s is not None or bool(self._passed_s)

    @property
    def has_edge_ahead(self) -> bool:
        """Whether another edge is expected."""
        return self._next_s is not None

    @property
    def direction(self) -> float:
        """Sign of the last rise heard of; 0 when none."""
        if self._next_s is not None:
            return float(np.sign(self._next_rise))
        return float(np.sign(self._passed_rise[-1])) if self._passed_rise else 0.0

    def advance(self, distance: float, dt: float) -> None:
        """Move the map because the robot moved.

        Args:
            distance: how far along the stairs, metres.
            dt: time it took, seconds.
        """
        self._passed_s = [s - distance for s in self._passed_s]
        while self._passed_s and self._passed_s[0] < -FORGET_BEHIND_M:
            self._passed_s.pop(0)
            self._level_behind += self._passed_rise.pop(0)
        if self._next_s is not None:
            self._next_s -= distance
            self._unconfirmed_s += dt
            if self._unconfirmed_s > LOST_AFTER_S:
                self._next_s = None

    def observe(self, block: StairBlock, front_hip_s: float) -> None:
        """Take the stair block of the latest observation in.

        Args:
            block: as observed.
            front_hip_s: position of the midpoint of the front hips, metres.
        """
        if block.valid < 0.5:
            self._extends = False
            if self._next_s is not None and self._next_s < front_hip_s:
                self._pass_next()
            return
        target = block.edge_distance + front_hip_s
        self._tread = max(block.step_width, 0.1)
        if self._next_s is not None:
            error = target - self._next_s
            if error > 0.5 * self._tread:  # the next edge is another one now
                self._pass_next()
            elif error > -0.5 * self._tread:
                self._passed_s = [s + error for s in self._passed_s]
        self._next_s = target
        self._next_rise = float(np.sign(block.direction)) * block.step_height
        self._unconfirmed_s = 0.0
        self._extends = True

    def _pass_next(self) -> None:
        assert self._next_s is not None
        self._passed_s.append(self._next_s)
        self._passed_rise.append(self._next_rise)
        self._next_s = None

    def assume_on_flight(self, height_difference: float, count_limit: int = 4) -> None:
        """Fill in the edges between the rear and the front feet of a robot that starts in mid-flight.

        Args:
            height_difference: front feet above rear feet, measured by the joints, metres.
        """
        if self._next_s is None or abs(self._next_rise) < 0.01:
            return
        count = round(height_difference / self._next_rise)
        for k in range(min(max(count, 0), count_limit), 0, -1):
            self._passed_s.append(self._next_s - k * self._tread)
            self._passed_rise.append(self._next_rise)
            self._level_behind -= self._next_rise

    def edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n,) and signed rises (n,), metres, sorted; one more step than observed is assumed ahead."""
        s, rise = list(self._passed_s), list(self._passed_rise)
        if self._next_s is not None:
            s.append(self._next_s)
            rise.append(self._next_rise)
            if self._extends:
                s.append(self._next_s + self._tread)
                rise.append(self._next_rise)
        return np.array(s), np.array(rise)

    def heights_at(self, s: np.ndarray) -> np.ndarray:
        """Ground height at positions s (n,), metres."""
        edge_s, rise = self.edges()
        if not len(edge_s):
            return np.full(len(s), self._level_behind)
        return self._level_behind + (rise * (edge_s < s[:, None])).sum(axis=1)

    def clear_of_edges(self, s: float, before: float, after: float, after_drop: float, choosing: bool = False) -> float:
        """Nearest position on the same tread that is clear of its edges.

        Args:
            s: wanted position, metres.
            before: distance to keep on the near side of an edge, metres.
            after: the same on the far side of an edge that leads up.
            after_drop: the same on the far side of an edge that leads down, where the shin needs room behind it.
            choosing: the tread is still to be chosen: next to a drop, take the one that asks the smaller detour.

        Returns:
            Position that stays where it is when it is passed in again, however the map is corrected by less than
            the margins.
        """
        edge_s, rise = self.edges()
        room = np.where(rise > 0, after, after_drop)
        borders = edge_s + (room - before) / 2 if choosing else edge_s
        behind = int((borders <= s).sum())  # edges on the near side of the tread
        low, high = -np.inf, np.inf
        if behind > 0:
            low = edge_s[behind - 1] + min(room[behind - 1], 0.6 * self._tread)
        if behind < len(edge_s):
            high = edge_s[behind] - min(before, 0.3 * self._tread)
        return float(max(min(s, high), low))

    def highest_between(self, start: float, end: float) -> float:
        """Highest ground on the way from start to end, metres."""
        edge_s, _ = self.edges()
        inside = edge_s[(edge_s > min(start, end)) & (edge_s < max(start, end))]
        samples = np.concatenate([[start, end], inside - 1e-3, inside + 1e-3])
        return float(self.heights_at(samples).max())
