"""True motion of the trunk between two control steps, from which inertial sensors read."""

from __future__ import annotations

import numpy as np

from stair_env.simulation import GRAVITY, PHYSICS_RATE_HZ, BaseState


class MotionRecorder:
    """Collects the base's states at the physics rate.

    Args:
        state: where the motion begins.
    """

    def __init__(self, state: BaseState) -> None:
        self._states = [state]

    @property
    def last(self) -> BaseState:
        """Newest state."""
        return self._states[-1]

    def begin(self) -> None:
        """Forget all but the newest state: a control step begins."""
        self._states = [self._states[-1]]

    def record(self, state: BaseState) -> None:
        """Add the state after a physics step."""
        self._states.append(state)

    def at_point(self, lever_arm: np.ndarray, sensor_to_base: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Specific force and angular velocity that a sensor fixed to the trunk undergoes.

        Args:
            lever_arm: (3,) sensor in the base frame, metres.
            sensor_to_base: (3, 3) rotation.

        Returns:
            (k, 3) specific force, m/s², and (k, 3) angular velocity, rad/s, both in the sensor's axes, one row per
            recorded physics step. At rest and level the force points up with 9.81 m/s².
        """
        rotations = np.array([state.rotation for state in self._states])  # (k + 1, 3, 3)
        angular = np.array([state.angular_velocity for state in self._states])
        arms = rotations @ lever_arm
        velocities = np.array([state.velocity for state in self._states]) + np.cross(angular, arms)
        acceleration = np.diff(velocities, axis=0) * PHYSICS_RATE_HZ
        acceleration[:, 2] += GRAVITY
        world_to_sensor = (rotations[1:] @ sensor_to_base).transpose(0, 2, 1)
        force = (world_to_sensor @ acceleration[:, :, None])[..., 0]
        rate = (world_to_sensor @ angular[1:, :, None])[..., 0]
        return force, rate
