"""Gravity in the camera frame from the D435i's accelerometer and gyro, fused.

A walking robot's accelerometer feels its own steps, metres per second squared of them; with the gyro it becomes an
attitude. The filter is `stair_env.attitude.AttitudeFilter` (x-io's imufusion).
"""

from __future__ import annotations

import numpy as np

from stair_env.attitude import AttitudeFilter

IMU_RATE_HZ = 240.0
GRAVITY_M_S2 = 9.8  # of the reported vector; only its direction is used


class CameraAttitude:
    """Follows gravity in the axes of the camera (x right, y down, z forward).

    Args:
        rate_hz: rate of the samples.
        gain: how fast the accelerometer corrects the gyro.
    """

    def __init__(self, rate_hz: float = IMU_RATE_HZ, gain: float = 0.1) -> None:
        self._filter = AttitudeFilter(rate_hz, gain=gain)
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
            self._started = True
        if len(samples):
            self._filter.update(samples[:, :3], samples[:, 3:])
        return self.gravity

    @property
    def gravity(self) -> np.ndarray:
        """(3,) what an accelerometer at rest would read now, m/s^2; level before the first sample."""
        if not self._started:
            return np.array([0.0, -GRAVITY_M_S2, 0.0])
        return GRAVITY_M_S2 * self._filter.up
