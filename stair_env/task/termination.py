"""How an episode goes, judged by the truth. None of it ever reaches the policy."""

from __future__ import annotations

import math

from stair_env.physics.simulation import BaseState
from stair_env.robots import RobotSpec
from stair_env.stairs import StairProfile, StairSpec

FALL_COSINE = 0.45  # trunk tilted more than 63° from upright
UPRIGHT_COSINE = 0.8  # a robot that has arrived is tilted less than 37°
FALL_HEIGHT_SHARE = 0.4  # of the standing height above the ground below
WALKED_AWAY_M = 1.5  # behind the start
LANDED_M = 0.15  # how far a foot that stands on the landing may be above or below it
FAILURES = ("fall", "left_flight", "walked_away")


class Judge:
    """Knows one episode's staircase.

    Args:
        stairs: the staircase.
        profile: its side view.
        robot: who climbs.
        start_x: where its base began, metres.
    """

    def __init__(self, stairs: StairSpec, profile: StairProfile, robot: RobotSpec, start_x: float) -> None:
        self._profile = profile
        self._half_width = stairs.flight_width / 2
        self._last_edge, self._final_level = float(profile.edge_x[-1]), float(profile.level_z[-1])
        self._wheelbase = robot.hip_x[0] - robot.hip_x[1]
        self._low_trunk = FALL_HEIGHT_SHARE * robot.stand_height
        self._turning_point = start_x - WALKED_AWAY_M

    def steps_behind(self, x: float) -> int:
        """Number of edges that a base at x has behind it."""
        return self._profile.edges_before(x)

    def local_slope(self, feet: list[list[float]]) -> float:
        """Slope of the ground under the feet, radians, positive where it rises ahead.

        Args:
            feet: (4, 3) world, metres.
        """
        front_right, front_left, rear_right, rear_left = (self._profile.level_under(x) for x, _, _ in feet)
        return math.atan2((front_right + front_left - rear_right - rear_left) / 2, self._wheelbase)

    def termination(self, state: BaseState, feet: list[list[float]]) -> str:
        """Why the episode is over, empty while it is not.

        Args:
            state: of the base.
            feet: (4, 3) world, metres.

        Returns:
            "success" (both rear feet on the landing, upright), one of `FAILURES`, or "".
        """
        (x, y, z), up = state.position.tolist(), float(state.rotation[2, 2])
        if not math.isfinite(x + y + z):
            return "fall"
        mean_under_feet = sum(self._profile.level_under(foot[0]) for foot in feet) / 4
        if up < FALL_COSINE or z - min(self._profile.level_under(x), mean_under_feet) < self._low_trunk:
            return "fall"
        if abs(y) > self._half_width and 0.0 < x < self._last_edge:
            return "left_flight"
        if x < self._turning_point:
            return "walked_away"
        landed = all(x > self._last_edge and abs(z - self._final_level) < LANDED_M for x, _, z in feet[2:])
        return "success" if landed and up > UPRIGHT_COSINE else ""
