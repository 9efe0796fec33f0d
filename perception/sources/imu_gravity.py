"""Gravity from a device's accelerometer and gyro, which sample at rates of their own."""

from __future__ import annotations

import numpy as np

from perception.sources.source import ImuSamples, no_samples
from perception.tracking.camera_gravity import CameraAttitude
from stair_env.common.constants import NOMINAL_GRAVITY_M_S2

# Both sensors are brought to it: a D435i's gyro has 200 or 400 Hz, its accelerometer 62.5 or 250.
FILTER_RATE_HZ = 200.0
MAX_GAP_S = 0.5  # without samples: the filter starts anew
FIRST_SAMPLES = 5  # a fortieth of a second
STILL_S = 0.25  # of accelerometer that is averaged where there is no gyro


class ImuGravity:
    """Follows gravity through a stream of IMU samples.

    With gyro the two are fused (`perception.tracking.camera_gravity`); the first samples are taken to be at rest.
    Without one the accelerometer's last quarter of a second is averaged, right for a camera that is held still.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget."""
        self._attitude = CameraAttitude(FILTER_RATE_HZ)
        self._acceleration, self._rate = no_samples(), no_samples()
        self._next_s: float | None = None
        self._gravity: np.ndarray | None = None

    @property
    def gravity(self) -> np.ndarray | None:
        """(3,) what an accelerometer at rest would read, m/s^2, camera axes; None before the first sample."""
        return None if self._gravity is None else self._gravity.copy()

    def update(self, imu: ImuSamples, until_s: float | None = None) -> np.ndarray | None:
        """Take samples in.

        Args:
            imu: samples since the last call.
            until_s: when the frame was captured that gravity is wanted for: a frame comes later than it was captured,
                and samples of after that wait for the next one. None, or a time of another clock, takes all.

        Returns:
            `gravity`.
        """
        self._acceleration = np.concatenate([self._acceleration, _finite(imu.acceleration)])
        self._rate = np.concatenate([self._rate, _finite(imu.rate)])
        if len(self._acceleration) == 0:
            return self.gravity
        first, last = self._acceleration[0, 0], self._acceleration[-1, 0]
        own_clock = until_s is not None and first - MAX_GAP_S < until_s < last + MAX_GAP_S
        end = min(until_s, last) if own_clock and until_s is not None else last
        if len(self._rate) == 0:
            self._average(end)
        else:
            self._fuse(end)
        return self.gravity

    def _average(self, end: float) -> None:
        self._acceleration = self._acceleration[self._acceleration[:, 0] > end - STILL_S]
        before = self._acceleration[:, 0] <= end
        mean = self._acceleration[before if before.any() else slice(None), 1:].mean(axis=0)
        length = float(np.linalg.norm(mean))
        if length > 0.0:
            self._gravity = NOMINAL_GRAVITY_M_S2 * mean / length

    def _fuse(self, end: float) -> None:
        """Both sensors at the filter's times, as far as both have come; what is left over waits for the next frame."""
        begin = max(self._acceleration[0, 0], self._rate[0, 0])
        end = min(end, self._rate[-1, 0])
        if self._next_s is None or not begin - MAX_GAP_S < self._next_s < end + MAX_GAP_S:
            self._attitude.reset()
            self._next_s = begin
        times = np.arange(self._next_s, end, 1.0 / FILTER_RATE_HZ)
        if len(times) == 0:
            if self._gravity is None:
                self._average(end)
            return
        samples = [
            np.column_stack([np.interp(times, rows[:, 0], rows[:, axis]) for axis in (1, 2, 3)])
            for rows in (self._acceleration, self._rate)
        ]
        joined = np.concatenate(samples, axis=1)
        # The filter takes its first call's mean to be at rest: the first moment alone, as a robot may walk on at once.
        self._attitude.update(joined[:FIRST_SAMPLES])
        self._gravity = self._attitude.update(joined[FIRST_SAMPLES:])
        self._next_s = float(times[-1]) + 1.0 / FILTER_RATE_HZ
        self._acceleration, self._rate = (_from(rows, self._next_s) for rows in (self._acceleration, self._rate))


def _finite(rows: np.ndarray) -> np.ndarray:
    rows = np.asarray(rows, np.float64)
    return rows[np.isfinite(rows).all(axis=1)]


def _from(rows: np.ndarray, time_s: float) -> np.ndarray:
    """Rows from the last one before a time on, which interpolation still needs."""
    first = max(int(np.searchsorted(rows[:, 0], time_s)) - 1, 0)
    return rows[min(first, len(rows) - 1) :]
