"""What the gait remembers of the stairs: a strip of edges ahead of and behind the base.

The map is one-dimensional, along the walking direction of the stairs, and moves with the robot: s = 0 is the base,
positive s lies ahead. It is filled from the stair block alone and remembers the edges the front feet have passed,
because the rear feet still have to climb them. It holds a handful of edges and is asked some twenty times a control
step: plain floats are several times faster than arrays here, and the list of edges is made once per change.
"""

from __future__ import annotations

import math

import numpy as np

from stair_env.observation import StairBlock

FORGET_BEHIND_M = 1.5
SLIP_MEMORY_M = 0.5  # of odometry, over which the feet's slip is learned
SLIP_RANGE = (0.85, 1.05)  # true distance per distance of the odometry: what lasts; bursts of slip do not
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
        self._edges: list[tuple[float, float]] | None = None  # what `edges` found; None once the map has changed
        self._passed_s: list[float] = []
        self._passed_rise: list[float] = []
        self._next_s: float | None = None
        self._next_rise = 0.0
        self._tread = 0.3
        self._level_behind = level  # of the ground before the first remembered edge
        self._unconfirmed_s = 0.0
        self._extends = False
        self._since_block = 0.0  # odometry since the last block, metres
        self._odometry_m, self._true_m = 0.0, 0.0  # fading sums of what odometry and blocks say was walked

    @property
    def slip(self) -> float:
        """True distance per distance of the odometry, learned from how the next edge comes nearer; 1 at first."""
        prior = 0.2 * SLIP_MEMORY_M
        return min(max((self._true_m + prior) / (self._odometry_m + prior), SLIP_RANGE[0]), SLIP_RANGE[1])

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
            return _sign(self._next_rise)
        return _sign(self._passed_rise[-1]) if self._passed_rise else 0.0

    def advance(self, distance: float, dt: float) -> None:
        """Move the map because the robot moved.

        Args:
            distance: how far along the stairs by odometry, metres.
            dt: time it took, seconds.
        """
        self._edges = None
        self._since_block += distance
        distance *= self.slip
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
        self._edges = None
        if block.valid < 0.5:
            self._extends = False
            if self._next_s is not None and self._next_s < front_hip_s:
                self._pass_next()
            return
        target = float(block.edge_distance) + front_hip_s
        self._tread = max(float(block.step_width), 0.1)
        if self._next_s is not None:
            error = target - self._next_s
            if error > 0.5 * self._tread:  # the next edge is another one now
                self._pass_next()
            elif error > -0.5 * self._tread:
                self._passed_s = [s + error for s in self._passed_s]
                self._learn_slip(error)
        self._since_block = 0.0
        self._next_s = target
        self._next_rise = _sign(float(block.direction)) * float(block.step_height)
        self._unconfirmed_s = 0.0
        self._extends = True

    def _learn_slip(self, error: float) -> None:
        """Feet that slip or pivot make the odometry read too far; the edge ahead tells by how much."""
        fade = math.exp(-abs(self._since_block) / SLIP_MEMORY_M)
        self._true_m = fade * self._true_m + self._since_block * self.slip - error
        self._odometry_m = fade * self._odometry_m + self._since_block

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
        self._edges = None
        count = round(height_difference / self._next_rise)
        for k in range(min(max(count, 0), count_limit), 0, -1):
            self._passed_s.append(self._next_s - k * self._tread)
            self._passed_rise.append(self._next_rise)
            self._level_behind -= self._next_rise

    def edges(self) -> list[tuple[float, float]]:
        """Position and signed rise of each edge, metres, sorted; one more step than observed is assumed ahead."""
        if self._edges is None:
            self._edges = list(zip(self._passed_s, self._passed_rise))
            if self._next_s is not None:
                self._edges.append((self._next_s, self._next_rise))
                if self._extends:
                    self._edges.append((self._next_s + self._tread, self._next_rise))
        return self._edges

    def height_at(self, s: float) -> float:
        """Ground height at position s, metres."""
        level = self._level_behind
        for edge_s, rise in self.edges():
            if edge_s < s:
                level += rise
        return level

    def heights_at(self, s: np.ndarray) -> np.ndarray:
        """Ground height at positions s (n,), metres."""
        return np.array([self.height_at(value) for value in s])

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
        edges, behind = self.edges(), 0  # edges on the near side of the tread
        for edge_s, rise in edges:
            room = after if rise > 0 else after_drop
            behind += edge_s + ((room - before) / 2 if choosing else 0.0) <= s
        low, high = -math.inf, math.inf
        if behind > 0:
            edge_s, rise = edges[behind - 1]
            low = edge_s + min(after if rise > 0 else after_drop, 0.6 * self._tread)
        if behind < len(edges):
            high = edges[behind][0] - min(before, 0.3 * self._tread)
        return max(min(s, high), low)

    def highest_between(self, start: float, end: float) -> float:
        """Highest ground on the way from start to end, metres."""
        highest = max(self.height_at(start), self.height_at(end))
        low, high = min(start, end), max(start, end)
        for edge_s, _ in self.edges():
            if low < edge_s < high:
                highest = max(highest, self.height_at(edge_s - 1e-3), self.height_at(edge_s + 1e-3))
        return highest


def _sign(value: float) -> float:
    """-1, 0 or 1."""
    return float((value > 0) - (value < 0))
