"""What the physics tells: the trunk's state and motion, contacts, joints and feet."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from stair_env.common.constants import GRAVITY_M_S2, PHYSICS_RATE_HZ
from stair_env.physics.body_kernels import ANGULAR_VELOCITY, POSITION, ROTATION, VELOCITY, feel


class BaseState(NamedTuple):
    """Trunk state in the world frame.

    Attributes:
        position: (3,) origin of the canonical base frame, metres.
        rotation: (3, 3) base to world.
        velocity: (3,) of the origin, m/s.
        angular_velocity: (3,) rad/s.
    """

    position: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray

    @property
    def yaw(self) -> float:
        """Heading about world z, radians."""
        return math.atan2(self.rotation[1, 0], self.rotation[0, 0])


class BaseTrack(NamedTuple):
    """True motion of the trunk over k physics steps, from which inertial sensors read.

    Rows are (18,) float64: position (3,), rotation base to world (9,) row by row, velocity (3,) and angular velocity
    (3,), see `stair_env.physics.body_kernels.trace_trunk`.

    Attributes:
        start: (18,) before the first step.
        rows: (k, 18) after each step.
    """

    start: np.ndarray
    rows: np.ndarray

    @property
    def last(self) -> BaseState:
        """The newest state, read-only; without any step the one at the start."""
        row = self.rows[-1] if len(self.rows) else self.start[:]
        row.setflags(write=False)  # of this view of it
        return BaseState(
            position=row[POSITION:ROTATION],
            rotation=row[ROTATION:VELOCITY].reshape(3, 3),
            velocity=row[VELOCITY:ANGULAR_VELOCITY],
            angular_velocity=row[ANGULAR_VELOCITY:],
        )

    def felt_at(self, lever_arm: np.ndarray, sensor_to_base: np.ndarray) -> np.ndarray:
        """Specific force and angular velocity that a sensor fixed to the trunk undergoes.

        Args:
            lever_arm: (3,) sensor in the base frame, metres.
            sensor_to_base: (3, 3) rotation.

        Returns:
            (k, 6) float64, one row per physics step: specific force, m/s², and angular velocity, rad/s, in the
            sensor's axes. At rest and level the force points up with 9.81 m/s².
        """
        rate_hz = float(PHYSICS_RATE_HZ)
        felt: np.ndarray = feel(self.start, self.rows, lever_arm, sensor_to_base.ravel(), rate_hz, GRAVITY_M_S2)
        return felt


class FootContacts(NamedTuple):
    """Contacts of one control step's last physics step.

    Attributes:
        touching: (4,) bool.
        force: (4, 3) force of the ground on each foot, world frame, newtons.
        body_touches: whether any other part of the robot touches something.
    """

    touching: np.ndarray
    force: np.ndarray
    body_touches: bool


class RobotReading(NamedTuple):
    """Joints and feet at the end of a control step.

    Attributes:
        joint_positions: (12,) canonical angles, radians.
        joint_velocities: (12,) rad/s.
        joint_torques: (12,) of the motors in the last physics step, N·m.
        contacts: of the feet.
        feet: (4, 3) foot centres, world frame, metres.
    """

    joint_positions: np.ndarray
    joint_velocities: np.ndarray
    joint_torques: np.ndarray
    contacts: FootContacts
    feet: np.ndarray


def base_to_world(state: BaseState) -> np.ndarray:
    """(4, 4) pose of the base."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = state.rotation, state.position
    return transform
