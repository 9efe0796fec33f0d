"""Which way is down, from accelerometer and gyro together.

A walking robot's accelerometer alone is wrong by metres per second squared; fused with the gyro it is right to
fractions of a degree. The filter is x-io's `imufusion` (Madgwick's revised complementary filter).
"""

from __future__ import annotations

import math

import numpy as np

from stair_env.common.constants import STANDARD_GRAVITY_M_S2
from stair_env.common.pickling import PicklesByArguments
from stair_env.physics.body_kernels import level_turn

DEGREES_PER_RADIAN = 180.0 / math.pi


class AttitudeFilter(PicklesByArguments):
    """Fuses samples into a direction of gravity, in the frame that the samples are given in.

    The yaw it carries is the integrated gyro's, without reference.

    Args:
        sample_rate_hz: rate of the samples.
        gain: how fast the accelerometer corrects the gyro; small because feet hit the ground twice a stride.
        acceleration_rejection_deg: a reading that disagrees by more is not used.
    """

    def __init__(self, sample_rate_hz: float, gain: float = 0.1, acceleration_rejection_deg: float = 10.0) -> None:
        import imufusion

        self._fusion = imufusion
        self._ahrs = imufusion.Ahrs()
        settings = imufusion.AhrsSettings()
        settings.sample_rate = sample_rate_hz
        settings.convention = imufusion.CONVENTION_NWU
        settings.gain = gain
        settings.gyroscope_range = 1000.0
        settings.acceleration_rejection = acceleration_rejection_deg
        settings.rejection_timeout = int(2 * sample_rate_hz)
        self._ahrs.set_settings(settings)
        self._read()

    def reset(self, accelerometer: np.ndarray) -> None:
        """Start from a reading at rest.

        Args:
            accelerometer: (3,) m/s², sensor axes.

        Raises:
            ValueError: the reading has no direction.
        """
        norm = float(np.linalg.norm(accelerometer))
        if not np.isfinite(norm) or norm < 1e-6:
            raise ValueError(f"accelerometer={accelerometer!r} gives no direction of gravity")
        self._ahrs.restart()
        self._ahrs.skip_startup()
        self._ahrs.set_quaternion(_level_quaternion(np.asarray(accelerometer) / norm))
        self._read()

    def update(self, accelerometer: np.ndarray, gyro: np.ndarray) -> None:
        """Take samples in.

        Args:
            accelerometer: (k, 3) specific force, m/s².
            gyro: (k, 3) rad/s.
        """
        update = self._ahrs.update_no_magnetometer
        # The library computes in single precision; handing it over spares a conversion per call.
        degrees, in_g = (
            (gyro * DEGREES_PER_RADIAN).astype(np.float32),
            (accelerometer / STANDARD_GRAVITY_M_S2).astype(np.float32),
        )
        for rate, force in zip(degrees, in_g):
            update(rate, force)
        self._read()

    def _read(self) -> None:
        self._sensor_to_level = np.asarray(self._fusion.quaternion_to_matrix(self._ahrs.get_quaternion()))

    @property
    def up(self) -> np.ndarray:
        """(3,) unit vector against gravity, sensor axes (what an accelerometer at rest would read)."""
        return self._sensor_to_level[2]

    @property
    def sensor_to_level_with_yaw(self) -> np.ndarray:
        """(3, 3) rotation from the sensor frame to a z-up frame of unknown but steady heading."""
        return self._sensor_to_level

    @property
    def yaw(self) -> float:
        """Heading of the sensor's x axis in that frame, radians."""
        return math.atan2(self._sensor_to_level[1, 0], self._sensor_to_level[0, 0])


def _level_quaternion(up: np.ndarray) -> np.ndarray:
    """Quaternion (w, x, y, z), sensor to z-up, of smallest rotation that turns `up` (3,) onto z."""
    axis = np.array([up[1], -up[0], 0.0])  # up × z
    w = 1.0 + up[2]
    if w < 1e-9:
        return np.array([0.0, 1.0, 0.0, 0.0])
    quaternion = np.array([w, *axis])
    return quaternion / np.linalg.norm(quaternion)


def base_to_level(up: np.ndarray) -> np.ndarray:
    """Rotation that takes roll and pitch out and leaves the heading alone.

    Args:
        up: (3,) unit vector against gravity in the base frame.

    Returns:
        (3, 3): level_vector = R @ base_vector; the level frame's x axis is the base's x axis laid flat.
    """
    turn: np.ndarray = level_turn(np.asarray(up, np.float64))
    return turn
