"""Dead reckoning: the accelerometer says how the trunk's velocity changes, standing feet what it is.

Feet that touch the ground do not always stand: they slip, pivot and bounce, and then mislead by metres per second for a
moment. They are believed by a little at a time, so that a bounce of a control step or two leaves no trace.
"""

from __future__ import annotations

import math

import numpy as np

from stair_env.common.constants import STANDARD_GRAVITY_M_S2
from stair_env.onboard.kinematics import LegKinematics
from stair_env.physics.body_kernels import displacement
from stair_env.robots import RobotSpec

# Chosen on 60 walks of AlienGo on the paper's stairs with pushes (docs/climbing.md): drift within half a second, RMS,
# 13 mm down and 5 mm up, where legs alone drift by 33 and 14 mm.
LEG_GAIN = 0.5  # share of the difference to the legs' velocity that is taken over in a control step
MAX_CORRECTION_M_S = 0.05  # and at most so much of it


class LegOdometry:
    """Velocity of the base, in a level frame that turns with it.

    Args:
        robot: supplies kinematics and foot radius.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._kinematics = LegKinematics(robot)
        self._radius = robot.foot_radius
        self.reset()

    def reset(self) -> None:
        """Start from standing."""
        self._last_stance: np.ndarray | None = None
        self._last_contact = np.zeros(4, bool)
        self._velocity = np.zeros(3)

    def update(
        self,
        joint_angles: np.ndarray,
        contact: np.ndarray,
        specific_force: np.ndarray,
        base_to_level: np.ndarray,
        yaw_change: float,
        dt: float,
    ) -> np.ndarray:
        """Velocity of the base after another control step.

        Args:
            joint_angles: (12,) canonical, radians.
            contact: (4,) bool, which feet touch.
            specific_force: (3,) mean of the accelerometer over the step, base frame, m/s^2.
            base_to_level: (3, 3) rotation that takes out pitch and roll.
            yaw_change: heading change since the last call, radians.
            dt: control step, seconds.

        Returns:
            (3,) m/s in the level frame of this step. Without a foot that stood through the step, the accelerometer's.
        """
        cos, sin = math.cos(yaw_change), math.sin(yaw_change)
        x, y, z = self._velocity
        velocity = np.array([cos * x + sin * y, cos * y - sin * x, z - STANDARD_GRAVITY_M_S2 * dt])
        velocity += (base_to_level @ specific_force) * dt
        stance = self._kinematics.stance(joint_angles, base_to_level)
        if self._last_stance is not None:
            moved = displacement(self._last_stance, stance, self._last_contact, contact, yaw_change, self._radius)
            if moved[0] == moved[0]:  # not NaN: a foot stood
                correction = LEG_GAIN * (moved / dt - velocity)
                size = math.sqrt(float(correction @ correction))
                velocity += correction * min(1.0, MAX_CORRECTION_M_S / max(size, 1e-9))
        self._velocity, self._last_stance, self._last_contact = velocity, stance, contact.copy()
        return velocity
