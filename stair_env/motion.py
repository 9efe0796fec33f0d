"""True motion of the trunk between two control steps, from which inertial sensors read."""

from __future__ import annotations

import numpy as np

from stair_env.simulation import GRAVITY, PHYSICS_RATE_HZ, BaseState, BaseTrack, cross


class MotionRecorder:
    """Holds the base's states at the physics rate over one control step.

    Args:
        state: where the motion begins.
    """

    def __init__(self, state: BaseState) -> None:
        self.last = state
        self._rotations, self._velocities = state.rotation[None], state.velocity[None]
        self._angular = state.angular_velocity[None]

    def record(self, track: BaseTrack) -> None:
        """Take the states of a control step in and forget those before its beginning."""
        start, self.last = self.last, track.state(-1)
        self._rotations = np.concatenate([start.rotation[None], track.rotation])
        self._velocities = np.concatenate([start.velocity[None], track.velocity])
        self._angular = np.concatenate([start.angular_velocity[None], track.angular_velocity])

    def at_point(self, lever_arm: np.ndarray, sensor_to_base: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Specific force and angular velocity that a sensor fixed to the trunk undergoes.

        Args:
            lever_arm: (3,) sensor in the base frame, metres.
            sensor_to_base: (3, 3) rotation.

        Returns:
            (k, 3) specific force, m/s², and (k, 3) angular velocity, rad/s, both in the sensor's axes, one row per
            recorded physics step. At rest and level the force points up with 9.81 m/s².
        """
        velocities = self._velocities + cross(self._angular, self._rotations @ lever_arm)
        sensor_to_world = self._rotations[1:] @ sensor_to_base
        return _felt(velocities, self._angular[1:], sensor_to_world)

    def at_base(self) -> tuple[np.ndarray, np.ndarray]:
        """The same as `at_point` for a sensor in the base's origin with the base's axes."""
        return _felt(self._velocities, self._angular[1:], self._rotations[1:])


def _felt(velocities: np.ndarray, angular: np.ndarray, sensor_to_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Specific force and angular velocity in the sensor's axes, (k, 3) each, of a sensor with (k + 1, 3) velocities."""
    acceleration = (velocities[1:] - velocities[:-1]) * PHYSICS_RATE_HZ
    acceleration[:, 2] += GRAVITY
    world_to_sensor = sensor_to_world.transpose(0, 2, 1)
    force = (world_to_sensor @ acceleration[:, :, None])[..., 0]
    rate = (world_to_sensor @ angular[:, :, None])[..., 0]
    return force, rate
