"""True motion of the trunk between two control steps, from which inertial sensors read."""

from __future__ import annotations

import numpy as np

from stair_env.common.constants import GRAVITY_M_S2
from stair_env.physics.body_kernels import TRACK_WIDTH, feel
from stair_env.physics.simulation import PHYSICS_RATE_HZ, BaseState, BaseTrack

AT_ORIGIN, ALONG_BASE = np.zeros(3), np.eye(3)  # a sensor in the base's origin with the base's axes


class MotionRecorder:
    """Holds the trunk's track over one control step.

    Args:
        state: where the motion begins.
    """

    def __init__(self, state: BaseState) -> None:
        self.last = state
        parts = (state.position, state.rotation.ravel(), state.velocity, state.angular_velocity)
        self._last_row = self._start_row = np.concatenate(parts)
        self._rows = np.empty((0, TRACK_WIDTH))

    def record(self, track: BaseTrack) -> None:
        """Take the track of a control step in and forget those before its beginning."""
        self.last = track.state(-1)
        self._start_row, self._last_row, self._rows = self._last_row, track.rows[-1], track.rows

    def at_point(self, lever_arm: np.ndarray, sensor_to_base: np.ndarray) -> np.ndarray:
        """Specific force and angular velocity that a sensor fixed to the trunk undergoes.

        Args:
            lever_arm: (3,) sensor in the base frame, metres.
            sensor_to_base: (3, 3) rotation.

        Returns:
            (k, 6) float64, one row per recorded physics step: specific force, m/s², and angular velocity, rad/s, in the
            sensor's axes. At rest and level the force points up with 9.81 m/s².
        """
        felt: np.ndarray = feel(
            self._start_row, self._rows, lever_arm, sensor_to_base.ravel(), float(PHYSICS_RATE_HZ), GRAVITY_M_S2
        )
        return felt

    def at_base(self) -> np.ndarray:
        """The same as `at_point` for a sensor in the base's origin with the base's axes."""
        return self.at_point(AT_ORIGIN, ALONG_BASE)
