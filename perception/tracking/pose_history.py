"""Where the robot has walked to: planar dead reckoning with a memory, so that late measurements find their place.

The velocity comes from the observation (leg kinematics of the standing feet, gravity from the IMU, heading from the
gyro; see `stair_env.onboard.proprioception`). It drifts by a few per cent, which the tracker is built to absorb.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

HISTORY_S = 2.0  # longer than any camera's latency


@dataclass(frozen=True)
class PlanarPose:
    """Base in the odometry frame: x, y metres, heading radians (counter-clockwise), time seconds."""

    time_s: float
    x: float
    y: float
    heading: float


class PlanarOdometry:
    """Integrates level-frame velocities into a pose and remembers the last seconds."""

    def __init__(self) -> None:
        self.reset(0.0)

    def reset(self, time_s: float) -> None:
        """Start at the origin of a new odometry frame."""
        self._history: deque[PlanarPose] = deque([PlanarPose(time_s, 0.0, 0.0, 0.0)])

    @property
    def pose(self) -> PlanarPose:
        """The latest pose."""
        return self._history[-1]

    def advance(self, time_s: float, forward_m_s: float, left_m_s: float, yaw_rate: float) -> PlanarPose:
        """Walk on.

        Args:
            time_s: now; a time that is not later than the last one changes nothing.
            forward_m_s, left_m_s: mean velocity since the last call in the level frame of the base, as it stands now.
            yaw_rate: mean rate of the heading since the last call, rad/s.

        Returns:
            The new pose.
        """
        last = self.pose
        dt = time_s - last.time_s
        if dt <= 0.0 or not all(map(math.isfinite, (forward_m_s, left_m_s, yaw_rate))):
            return last
        heading = last.heading + yaw_rate * dt
        cos, sin = math.cos(heading), math.sin(heading)
        pose = PlanarPose(
            time_s,
            last.x + dt * (cos * forward_m_s - sin * left_m_s),
            last.y + dt * (sin * forward_m_s + cos * left_m_s),
            heading,
        )
        self._history.append(pose)
        while len(self._history) > 2 and self._history[1].time_s < time_s - HISTORY_S:
            self._history.popleft()
        return pose

    def pose_at(self, time_s: float) -> PlanarPose:
        """The pose at an earlier time, between remembered ones interpolated; the oldest if it is older than all."""
        after = self._history[-1]
        if time_s >= after.time_s:
            return after
        for before in reversed(self._history):
            if before.time_s <= time_s:
                return _between(before, after, time_s)
            after = before
        return self._history[0]


def _between(before: PlanarPose, after: PlanarPose, time_s: float) -> PlanarPose:
    span = after.time_s - before.time_s
    t = (time_s - before.time_s) / span if span > 0.0 else 0.0
    return PlanarPose(
        time_s,
        before.x + t * (after.x - before.x),
        before.y + t * (after.y - before.y),
        before.heading + t * (after.heading - before.heading),
    )
