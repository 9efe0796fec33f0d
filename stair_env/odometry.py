"""Dead reckoning from legs: feet that stand do not move, so the trunk does."""

from __future__ import annotations

import math

import numpy as np

from stair_env.kinematics import LegKinematics
from stair_env.robots import RobotSpec


class LegOdometry:
    """Displacement of the base per control step, in a level frame that turns with it.

    Args:
        robot: supplies kinematics and foot radius.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._kinematics = LegKinematics(robot)
        self._radius = robot.foot_radius
        self.reset()

    def reset(self) -> None:
        """Forget the last step."""
        self._last_feet: np.ndarray | None = None
        self._last_shank: np.ndarray | None = None
        self._last_contact = np.zeros(4, bool)
        self._velocity = np.zeros(3)

    def update(
        self, joint_angles: np.ndarray, contact: np.ndarray, base_to_level: np.ndarray, yaw_change: float, dt: float
    ) -> np.ndarray:
        """Mean velocity of the base over the last control step.

        Args:
            joint_angles: (12,) canonical, radians.
            contact: (4,) which feet touch.
            base_to_level: (3, 3) rotation that takes out pitch and roll.
            yaw_change: heading change since the last call, radians.
            dt: control step, seconds.

        Returns:
            (3,) m/s in the level frame of this step. Without a foot that stood through the step, the last value.
        """
        feet = self._kinematics.foot_positions(joint_angles) @ base_to_level.T
        body_pitch = np.arctan2(-base_to_level[2, 0], base_to_level[0, 0])
        angles = joint_angles.reshape(4, 3)
        shank = body_pitch + angles[:, 1] + angles[:, 2]
        standing = np.asarray(contact, bool) & self._last_contact
        if self._last_feet is not None and self._last_shank is not None and standing.any():
            cos, sin = math.cos(yaw_change), math.sin(yaw_change)
            turned = self._last_feet @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
            moved = turned[standing] - feet[standing]
            # A round foot rolls: its centre travels r per radian of shank rotation.
            moved[:, 0] += self._radius * (shank - self._last_shank)[standing]
            self._velocity = _median(moved) / dt
        self._last_feet, self._last_shank, self._last_contact = feet, shank, np.asarray(contact, bool).copy()
        return self._velocity


def _median(rows: np.ndarray) -> np.ndarray:
    """Median of each column (numpy's own costs ten times as much at this size)."""
    ordered = np.sort(rows, axis=0)
    count = len(ordered)
    return (ordered[(count - 1) // 2] + ordered[count // 2]) / 2
