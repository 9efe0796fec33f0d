"""What a robot's sensors give in a control step, checked where it comes in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stair_env.robots import NUM_JOINTS


@dataclass(frozen=True)
class BodyReading:
    """A control step's readings of the robot's own sensors.

    Attributes:
        time_s: now.
        joint_position, joint_velocity: (12,) canonical (`stair_env.robots`), radians and rad/s.
        contact: (4,) bool, which feet touch the ground, in the order FR, FL, RR, RL.
        imu: (k, 6) accelerometer (m/s^2) and gyro (rad/s) of the trunk since the last reading, base axes, oldest first.

    Raises:
        ValueError: a shape is wrong, or a number is not finite.
    """

    time_s: float
    joint_position: np.ndarray
    joint_velocity: np.ndarray
    contact: np.ndarray
    imu: np.ndarray

    def __post_init__(self) -> None:
        for name, shape, kind in (
            ("joint_position", (NUM_JOINTS,), np.float64),
            ("joint_velocity", (NUM_JOINTS,), np.float64),
            ("contact", (4,), bool),
        ):
            value = np.asarray(getattr(self, name))
            if value.shape != shape or not np.isfinite(value).all():
                raise ValueError(f"{name} must be {shape[0]} finite numbers, got {value!r}")
            object.__setattr__(self, name, value.astype(kind))
        imu = np.asarray(self.imu, np.float64)
        if imu.ndim != 2 or imu.shape[1] != 6 or len(imu) == 0 or not np.isfinite(imu).all():
            raise ValueError(f"imu must be (k, 6) finite accelerometer and gyro samples, k >= 1, got shape {imu.shape}")
        object.__setattr__(self, "imu", imu)


@dataclass(frozen=True)
class CameraReading:
    """A frame of the robot's camera, when there is a new one.

    Attributes:
        number: grows from frame to frame.
        captured_at_s: on the clock of the body's readings.
        rgb: uint8 (H, W, 3).
        depth_m: float32 (H, W) metres, aligned to rgb, 0 = no reading.
    """

    number: int
    captured_at_s: float
    rgb: np.ndarray
    depth_m: np.ndarray
