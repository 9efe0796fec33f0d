"""What a robot knows of itself from joints, feet and the trunk's IMU: attitude, velocity, the proprioceptive block."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stair_env.common.constants import CONTROL_DT, PHYSICS_RATE_HZ
from stair_env.observation import pack_proprio
from stair_env.onboard.gait import Gait
from stair_env.onboard.kinematics import LegKinematics
from stair_env.onboard.proprioception import AttitudeFilter, LegOdometry, base_to_level
from stair_env.robots import NUM_JOINTS, RobotSpec


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
        for name, shape in (("joint_position", (NUM_JOINTS,)), ("joint_velocity", (NUM_JOINTS,)), ("contact", (4,))):
            value = np.asarray(getattr(self, name))
            if value.shape != shape or not np.isfinite(value).all():
                raise ValueError(f"{name} must be {shape[0]} finite numbers, got {value!r}")
        imu = np.asarray(self.imu)
        if imu.ndim != 2 or imu.shape[1] != 6 or len(imu) == 0 or not np.isfinite(imu).all():
            raise ValueError(f"imu must be (k, 6) finite accelerometer and gyro samples, k >= 1, got shape {imu.shape}")


class BodySense:
    """Follows the trunk through readings, as the environment does for its robot.

    Args:
        robot: supplies kinematics.
        imu_rate_hz: of the trunk's samples.
    """

    def __init__(self, robot: RobotSpec, imu_rate_hz: float = PHYSICS_RATE_HZ) -> None:
        self._attitude = AttitudeFilter(imu_rate_hz)
        self._odometry = LegOdometry(robot)
        self._kinematics = LegKinematics(robot)
        self._gyro, self._velocity, self._yaw_rate = np.zeros(3), np.zeros(3), 0.0

    def begin(self, reading: BodyReading, rest: np.ndarray | None = None) -> None:
        """Start from standing.

        Args:
            reading: while the robot stands.
            rest: (3,) accelerometer at rest, base axes; None takes the mean of the reading.
        """
        self._attitude.reset(reading.imu[:, :3].mean(axis=0) if rest is None else np.asarray(rest, np.float64))
        self._odometry.reset()
        self._gyro, self._velocity, self._yaw_rate = np.zeros(3), np.zeros(3), 0.0

    def update(self, reading: BodyReading) -> None:
        """Take a control step's reading in."""
        imu = np.asarray(reading.imu, np.float64)
        before = self._attitude.yaw
        self._attitude.update(imu[:, :3], imu[:, 3:])
        turn = self._attitude.yaw - before
        self._yaw_rate = ((turn + math.pi) % (2 * math.pi) - math.pi) / CONTROL_DT
        self._gyro = imu[-1, 3:]
        self._velocity = self._odometry.update(
            np.asarray(reading.joint_position, np.float64),
            np.asarray(reading.contact, bool),
            imu[:, :3].mean(axis=0),
            base_to_level(self._attitude.up),
            self._yaw_rate * CONTROL_DT,
            CONTROL_DT,
        )

    @property
    def velocity(self) -> np.ndarray:
        """(3,) m/s in the level frame that turns with the base."""
        return self._velocity

    def foot_heights(self, joint_position: np.ndarray) -> np.ndarray:
        """(4,) heights of the feet relative to the right front one, metres."""
        feet = self._kinematics.foot_positions(joint_position) @ base_to_level(self._attitude.up).T
        heights: np.ndarray = feet[:, 2] - feet[0, 2]
        return heights

    def proprio(self, reading: BodyReading, targets: np.ndarray, gait: Gait, last_action: np.ndarray) -> np.ndarray:
        """The proprioceptive block (`stair_env.observation.PROPRIO_FIELDS`), float32.

        Args:
            reading: the latest.
            targets: (12,) joint angles that were asked for last.
            gait: whose phase and footholds count.
            last_action: that was taken last.
        """
        phase = 2 * np.pi * gait.phase
        return pack_proprio(
            {
                "gravity": -self._attitude.up,
                "angular_velocity": self._gyro,
                "velocity": self._velocity,
                "yaw_rate": [self._yaw_rate],
                "joint_position": reading.joint_position,
                "joint_velocity": reading.joint_velocity,
                "joint_error": targets - reading.joint_position,
                "contact": reading.contact,
                "foothold_height": gait.foothold_heights,
                "phase": [math.sin(phase), math.cos(phase)],
                "last_action": last_action,
            }
        )
