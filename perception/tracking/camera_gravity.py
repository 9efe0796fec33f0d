"""Gravity in the camera frame from the D435i's accelerometer and gyro, fused.

A walking robot's accelerometer feels its own steps, metres per second squared of them, and the direction of a single
reading means nothing. Averaged over a stride, in the level frame that the gyro carries along, those accelerations
cancel and gravity remains. The average is what the filter, x-io's imufusion, corrects the gyro with.
"""

from __future__ import annotations

import numpy as np

from stair_env.common.constants import LEVEL_CAMERA_GRAVITY, NOMINAL_GRAVITY_M_S2
from stair_env.onboard.proprioception import AttitudeFilter

IMU_RATE_HZ = 240.0
AVERAGING_S = 0.8  # two strides of a trot; with the gain: measured on walking robots, docs/measuring.md
GAIN = 0.4  # balances the gyro's bias (0.0025 rad/s / gain) against what the average lets through
REJECT_NOTHING_DEG = 90.0  # the average has no outliers to reject


class CameraAttitude:
    """Follows gravity in the axes of the camera (x right, y down, z forward).

    Args:
        rate_hz: rate of the samples.
        gain: how fast the accelerometer corrects the gyro, 1/s.
        averaging_s: time constant of the accelerometer's average; 0 takes each reading as it is.
    """

    def __init__(self, rate_hz: float = IMU_RATE_HZ, gain: float = GAIN, averaging_s: float = AVERAGING_S) -> None:
        self._filter = AttitudeFilter(rate_hz, gain=gain, acceleration_rejection_deg=REJECT_NOTHING_DEG)
        self._share = 1.0 / max(averaging_s * rate_hz, 1.0)
        self._level_force = np.zeros(3)
        self._started = False

    def reset(self) -> None:
        """Forget; the next samples are taken to begin at rest."""
        self._started = False

    def update(self, samples: np.ndarray) -> np.ndarray:
        """Take samples in.

        Args:
            samples: (k, 6) specific force (m/s^2) and angular velocity (rad/s), oldest first. Rows that are not finite
                are skipped.

        Returns:
            (3,) what an accelerometer at rest would read now, m/s^2; (0, -9.8, 0) when level.

        Raises:
            ValueError: samples is not (k, 6), or the first one has no direction.
        """
        samples = np.asarray(samples, dtype=np.float64)
        if samples.ndim != 2 or samples.shape[1] != 6:
            raise ValueError(f"samples have shape {samples.shape}, must be (k, 6): accelerometer, gyro")
        samples = samples[np.isfinite(samples).all(axis=1)]
        if len(samples) and not self._started:
            self._filter.reset(samples[:, :3].mean(axis=0))
            self._level_force = np.array([0.0, 0.0, NOMINAL_GRAVITY_M_S2])
            self._started = True
        for sample in samples:
            self._take(sample)
        return self.gravity

    def _take(self, sample: np.ndarray) -> None:
        to_level = self._filter.sensor_to_level_with_yaw
        self._level_force = self._level_force + self._share * (to_level @ sample[:3] - self._level_force)
        self._filter.update((self._level_force @ to_level)[None], sample[None, 3:])

    @property
    def gravity(self) -> np.ndarray:
        """(3,) what an accelerometer at rest would read now, m/s^2; level before the first sample."""
        if not self._started:
            return np.array(LEVEL_CAMERA_GRAVITY)
        return NOMINAL_GRAVITY_M_S2 * self._filter.up
