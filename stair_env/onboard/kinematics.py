"""Forward and inverse kinematics of the three-joint legs (see `stair_env.robots` for the convention)."""

from __future__ import annotations

import numpy as np

from stair_env.physics.body_kernels import forward_legs, inverse_legs, level_stance
from stair_env.robots import LEG_SIDE, RobotSpec

REACH_MARGIN = 0.995  # fraction of the stretched leg that inverse kinematics will ask for
MIN_BEND_M = 0.05  # the nearest a foot may come to its hip axis, beyond what the link lengths ask


class LegKinematics:
    """Kinematics of all four legs at once, in the base frame.

    Args:
        robot: supplies hips and link lengths.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._hips = robot.hips
        self._side_offsets = LEG_SIDE * robot.hip_offset
        self._links = np.array([robot.upper_length, robot.lower_length])
        self._max_reach = REACH_MARGIN * (robot.upper_length + robot.lower_length)
        self._min_reach = abs(robot.upper_length - robot.lower_length) + MIN_BEND_M

    def foot_positions(self, joint_angles: np.ndarray) -> np.ndarray:
        """Foot centres from joint angles.

        Args:
            joint_angles: (12,) canonical angles, radians.

        Returns:
            (4, 3) float64, base frame, metres.
        """
        feet: np.ndarray = forward_legs(
            np.ascontiguousarray(joint_angles, np.float64), self._hips, self._side_offsets, self._links
        )
        return feet

    def stance(self, joint_angles: np.ndarray, base_to_level: np.ndarray) -> np.ndarray:
        """Where the feet are and how the shanks lean, in the level frame.

        Args:
            joint_angles: (12,) canonical angles, radians.
            base_to_level: (3, 3) rotation.

        Returns:
            (4, 4) float64: x, y, z of each foot's centre, metres, and the pitch of its shank, radians.
        """
        angles = np.ascontiguousarray(joint_angles, np.float64)
        stance: np.ndarray = level_stance(angles, self._hips, self._side_offsets, self._links, base_to_level)
        return stance

    def joint_angles(self, feet: np.ndarray) -> np.ndarray:
        """Joint angles that put the feet where asked; a foot out of reach is pulled to the nearest reach.

        Args:
            feet: (4, 3) base frame, metres.

        Returns:
            (12,) float64 canonical angles, radians.
        """
        angles: np.ndarray = inverse_legs(
            np.ascontiguousarray(feet, np.float64),
            self._hips,
            self._side_offsets,
            self._links,
            self._min_reach,
            self._max_reach,
        )
        return angles
