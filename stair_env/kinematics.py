"""Forward and inverse kinematics of the three-joint legs (see `stair_env.robots` for the convention)."""

from __future__ import annotations

import numpy as np

from stair_env.robots import LEG_SIDE, RobotSpec

REACH_MARGIN = 0.995  # fraction of the stretched leg that inverse kinematics will ask for


class LegKinematics:
    """Kinematics of all four legs at once, in the base frame.

    Args:
        robot: supplies hips and link lengths.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._hips = robot.hips
        self._side_offset = LEG_SIDE * robot.hip_offset
        self._upper, self._lower = robot.upper_length, robot.lower_length
        self._max_reach = REACH_MARGIN * (self._upper + self._lower)
        self._min_reach = abs(self._upper - self._lower) + 0.05

    def foot_positions(self, joint_angles: np.ndarray) -> np.ndarray:
        """Foot centres from joint angles.

        Args:
            joint_angles: (12,) canonical angles, radians.

        Returns:
            (4, 3) float64, base frame, metres.
        """
        abduction, upper, lower = joint_angles.reshape(4, 3).T
        knee = upper + lower
        x = -self._upper * np.sin(upper) - self._lower * np.sin(knee)
        down = -self._upper * np.cos(upper) - self._lower * np.cos(knee)
        cos, sin = np.cos(abduction), np.sin(abduction)
        feet = self._hips.copy()
        feet[:, 0] += x
        feet[:, 1] += self._side_offset * cos - down * sin
        feet[:, 2] += self._side_offset * sin + down * cos
        return feet

    def joint_angles(self, feet: np.ndarray) -> np.ndarray:
        """Joint angles that put the feet where asked; a foot out of reach is pulled to the nearest reach.

        Args:
            feet: (4, 3) base frame, metres.

        Returns:
            (12,) float64 canonical angles, radians.
        """
        x, y, z = (feet - self._hips).T
        down = -np.sqrt(np.maximum(y * y + z * z - self._side_offset**2, 1e-4))
        abduction = np.arctan2(z, y) - np.arctan2(down, self._side_offset)
        abduction = (abduction + np.pi) % (2 * np.pi) - np.pi
        reach = np.hypot(x, down)
        scale = np.minimum(np.maximum(reach, self._min_reach), self._max_reach) / reach
        x, down, reach = x * scale, down * scale, reach * scale
        bend = (reach**2 - self._upper**2 - self._lower**2) / (2 * self._upper * self._lower)
        lower = -np.arccos(np.minimum(np.maximum(bend, -1.0), 1.0))
        upper = np.arctan2(-x, -down) - np.arctan2(
            self._lower * np.sin(lower), self._upper + self._lower * np.cos(lower)
        )
        return np.array([abduction, upper, lower]).T.ravel()
