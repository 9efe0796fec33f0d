"""Dead reckoning from legs: feet that stand do not move, so the trunk does."""

from __future__ import annotations

import numpy as np

from stair_env.body_kernels import displacement
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
        self._last_stance: np.ndarray | None = None
        self._last_contact = np.zeros(4, bool)
        self._velocity = np.zeros(3)

    def update(
        self, joint_angles: np.ndarray, contact: np.ndarray, base_to_level: np.ndarray, yaw_change: float, dt: float
    ) -> np.ndarray:
        """Mean velocity of the base over the last control step.

        Args:
            joint_angles: (12,) canonical, radians.
            contact: (4,) bool, which feet touch.
            base_to_level: (3, 3) rotation that takes out pitch and roll.
            yaw_change: heading change since the last call, radians.
            dt: control step, seconds.

        Returns:
            (3,) m/s in the level frame of this step. Without a foot that stood through the step, the last value.
        """
        stance = self._kinematics.stance(joint_angles, base_to_level)
        if self._last_stance is not None:
            moved = displacement(self._last_stance, stance, self._last_contact, contact, yaw_change, self._radius)
            if moved[0] == moved[0]:  # not NaN: a foot stood
                self._velocity = moved / dt
        self._last_stance, self._last_contact = stance, contact.copy()
        return self._velocity
