"""What a robot knows of its own motion, from its IMU, joint encoders and foot contacts alone."""

from __future__ import annotations

import math

import numpy as np

from stair_env.common.constants import STANDARD_GRAVITY_M_S2
from stair_env.common.pickling import PicklesByArguments
from stair_env.observation import pack_proprio
from stair_env.onboard.kinematics import LegKinematics
from stair_env.onboard.planner import GaitPlanner
from stair_env.physics.body_kernels import displacement, level_turn
from stair_env.robots import RobotSpec

DEGREES_PER_RADIAN = 180.0 / math.pi
# Chosen on 60 walks of AlienGo on the paper's stairs with pushes (docs/climbing.md): drift within half a second, RMS,
# 13 mm down and 5 mm up, where legs alone drift by 33 and 14 mm.
LEG_GAIN = 0.5  # share of the difference to the legs' velocity that is taken over in a control step
MAX_CORRECTION_M_S = 0.05  # and at most so much of it


class AttitudeFilter(PicklesByArguments):
    """Fuses samples into a direction of gravity, in the frame that the samples are given in.

    A walking robot's accelerometer alone is wrong by metres per second squared; fused with the gyro it is right to
    fractions of a degree. The filter is x-io's `imufusion` (Madgwick's revised complementary filter).

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


class LegOdometry:
    """Velocity of the base, in a level frame that turns with it: dead reckoning by accelerometer and legs.

    The accelerometer says how the trunk's velocity changes, standing feet what it is. Feet that touch the ground do not
    always stand: they slip, pivot and bounce, and then mislead by metres per second for a moment. They are believed by
    a little at a time, so that a bounce of a control step or two leaves no trace.

    Args:
        robot: supplies kinematics and foot radius.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._kinematics = LegKinematics(robot)
        self._radius = robot.foot_radius
        self.reset()

    def reset(self) -> None:
        """Start from standing."""
        self._last_stance: np.ndarray | None = None
        self._last_contact = np.zeros(4, bool)
        self._velocity = np.zeros(3)

    def update(
        self,
        joint_angles: np.ndarray,
        contact: np.ndarray,
        specific_force: np.ndarray,
        base_to_level: np.ndarray,
        yaw_change: float,
        dt: float,
    ) -> np.ndarray:
        """Velocity of the base after another control step.

        Args:
            joint_angles: (12,) canonical, radians.
            contact: (4,) bool, which feet touch.
            specific_force: (3,) mean of the accelerometer over the step, base frame, m/s^2.
            base_to_level: (3, 3) rotation that takes out pitch and roll.
            yaw_change: heading change since the last call, radians.
            dt: control step, seconds.

        Returns:
            (3,) m/s in the level frame of this step. Without a foot that stood through the step, the accelerometer's.
        """
        cos, sin = math.cos(yaw_change), math.sin(yaw_change)
        x, y, z = self._velocity
        velocity = np.array([cos * x + sin * y, cos * y - sin * x, z - STANDARD_GRAVITY_M_S2 * dt])
        velocity += (base_to_level @ specific_force) * dt
        stance = self._kinematics.stance(joint_angles, base_to_level)
        if self._last_stance is not None:
            moved = displacement(self._last_stance, stance, self._last_contact, contact, yaw_change, self._radius)
            if moved[0] == moved[0]:  # not NaN: a foot stood
                correction = LEG_GAIN * (moved / dt - velocity)
                size = math.sqrt(float(correction @ correction))
                velocity += correction * min(1.0, MAX_CORRECTION_M_S / max(size, 1e-9))
        self._velocity, self._last_stance, self._last_contact = velocity, stance, contact.copy()
        return velocity


class Proprioception:
    """Attitude, odometry and the proprioceptive block of one robot, one control step at a time.

    The environment and the robot's side (`perception.deploy`) both sense with it.

    Args:
        robot: supplies kinematics and foot radius.
        imu_rate_hz: rate of the trunk's IMU, whose axes are the base's.

    Attributes:
        up: (3,) unit vector against gravity, base frame.
        velocity: (3,) of the base over the last control step, level frame that turns with it, m/s.
        yaw_rate: heading change over the last control step, rad/s.
        angular_velocity: (3,) newest gyro sample, base frame, rad/s.
    """

    def __init__(self, robot: RobotSpec, imu_rate_hz: float) -> None:
        self._attitude = AttitudeFilter(imu_rate_hz)
        self._odometry = LegOdometry(robot)
        self._kinematics = LegKinematics(robot)

    def reset(self, force_at_rest: np.ndarray) -> None:
        """Start from standing.

        Args:
            force_at_rest: (3,) what an accelerometer reads now, base frame, m/s².
        """
        self._attitude.reset(force_at_rest)
        self._odometry.reset()
        self.up = self._attitude.up
        self._level = base_to_level(self.up)
        self.velocity, self.angular_velocity, self.yaw_rate = np.zeros(3), np.zeros(3), 0.0

    @property
    def base_to_level(self) -> np.ndarray:
        """(3, 3) rotation that takes roll and pitch out."""
        return self._level

    def foot_heights(self, joint_positions: np.ndarray) -> np.ndarray:
        """(4,) heights of the feet relative to the right front one, metres.

        Args:
            joint_positions: (12,) canonical, radians.
        """
        feet = self._kinematics.foot_positions(joint_positions) @ self._level.T
        heights: np.ndarray = feet[:, 2] - feet[0, 2]
        return heights

    def update(self, imu: np.ndarray, joint_positions: np.ndarray, touching: np.ndarray, dt: float) -> None:
        """Take a control step's readings in.

        Args:
            imu: (k, 6) specific force, m/s², and angular velocity, rad/s, oldest sample first.
            joint_positions: (12,) canonical, radians.
            touching: (4,) bool, which feet touch the ground.
            dt: control step, seconds.
        """
        yaw_before = self._attitude.yaw
        self._attitude.update(imu[:, :3], imu[:, 3:])
        turn = self._attitude.yaw - yaw_before
        self.yaw_rate = ((turn + math.pi) % (2 * math.pi) - math.pi) / dt
        self.angular_velocity = imu[-1, 3:]
        self.up = self._attitude.up
        self._level = base_to_level(self.up)
        force = np.add.reduce(imu[:, :3], axis=0) / len(imu)  # the mean, in a third of the time
        self.velocity = self._odometry.update(joint_positions, touching, force, self._level, self.yaw_rate * dt, dt)

    def block(
        self,
        joint_positions: np.ndarray,
        joint_velocities: np.ndarray,
        joint_targets: np.ndarray,
        touching: np.ndarray,
        gait: GaitPlanner,
        last_action: np.ndarray,
    ) -> np.ndarray:
        """The proprioceptive block (`stair_env.observation.PROPRIO_FIELDS`), float32.

        Args:
            joint_positions, joint_velocities: (12,) canonical, radians and rad/s.
            joint_targets: (12,) what the motors were asked for last.
            touching: (4,) bool, which feet touch the ground.
            gait: whose phase and footholds count.
            last_action: that was taken last.
        """
        phase = 2 * np.pi * gait.phase
        return pack_proprio(
            {
                "gravity": -self.up,
                "angular_velocity": self.angular_velocity,
                "velocity": self.velocity,
                "yaw_rate": [self.yaw_rate],
                "joint_position": joint_positions,
                "joint_velocity": joint_velocities,
                "joint_error": joint_targets - joint_positions,
                "contact": touching,
                "foothold_height": gait.foothold_heights,
                "phase": [math.sin(phase), math.cos(phase)],
                "last_action": last_action,
            }
        )
