"""The D435i's inertial sensor, a Bosch BMI055.

Axes are those of the camera: x right, y down, z forward. An accelerometer feels specific force, acceleration minus
gravity, so that at rest and level it reads (0, -9.8, 0): the force that holds it up points against y.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stair_env.common.constants import GRAVITY_M_S2, STANDARD_GRAVITY_M_S2
from stair_env.common.validation import JsonSpec, SpecError, check_choice, check_limits, check_range
from stair_env.physics.body_kernels import digitise

if TYPE_CHECKING:
    from stair_env.physics.simulation import BaseTrack

IMU_PRESETS: tuple[str, ...] = ("d435i", "ideal")
# Where the sensor sits in the frame of the colour camera, metres (extrinsics read from a device, realsense-ros issue
# 2788: -5.5, 5.1, 11.7 mm from the left imager, which is 15 mm right of the colour imager).
IMU_POSITION_IN_CAMERA_M = (0.0205, -0.0051, -0.0117)
_BLOCK = 1024  # samples for which noise is drawn at a time


@dataclass(frozen=True)
class ImuConfig(JsonSpec):
    """What is wrong with the inertial sensor; the defaults are a BMI055 after the user's calibration.

    Args:
        accel_noise_density: white noise, m/s^2 / sqrt(Hz) (data sheet: 150 ug / sqrt(Hz)).
        gyro_noise_density: white noise, rad/s / sqrt(Hz) (data sheet: 0.014 deg/s / sqrt(Hz)).
        noise_scale: factor on both; units in the field were measured up to ten times worse.
        accel_bias: `reset` draws each axis's bias evenly within plus and minus this, m/s^2 (up to 0.38 on units
            that nobody calibrated).
        gyro_bias: likewise, rad/s (0.0025 measured).
        accel_bias_walk: diffusion of the bias, m/s^3 / sqrt(Hz) (published for this device: 6e-5 to 3e-3).
        gyro_bias_walk: likewise, rad/s^2 / sqrt(Hz) (published: 2.4e-6 to 2e-5).
        accel_range: largest reading, m/s^2 (the device is set to 4 g).
        gyro_range: largest reading, rad/s (1000 deg/s).
        accel_quantum, gyro_quantum: steps of the readings, m/s^2 and rad/s (12 and 16 bits); 0 for none.

    Raises:
        SpecError: a field is out of range (a ValueError).
    """

    ARGUMENT = "imu"

    accel_noise_density: float = 1.47e-3
    gyro_noise_density: float = 2.44e-4
    noise_scale: float = 1.0
    accel_bias: float = 0.05
    gyro_bias: float = 0.0025
    accel_bias_walk: float = 4e-4
    gyro_bias_walk: float = 7e-6
    accel_range: float = 4.0 * STANDARD_GRAVITY_M_S2
    gyro_range: float = 17.453292519943295
    accel_quantum: float = 0.0192
    gyro_quantum: float = 5.3e-4

    def __post_init__(self) -> None:
        check_limits(self, _LIMITS)

    @classmethod
    def ideal(cls) -> ImuConfig:
        """Nothing is wrong but the range."""
        kept = ("noise_scale", "accel_range", "gyro_range")
        return cls(**{entry.name: 0.0 for entry in dataclasses.fields(cls) if entry.name not in kept})

    @classmethod
    def from_dict(cls, values: Any) -> ImuConfig:
        """Build from JSON: None, a preset's name, or an object that names the fields to change from the D435i's.

        Raises:
            SpecError: an unknown name or a wrong value; the message names the choices.
        """
        if values is None:
            return cls()
        if isinstance(values, str):
            check_choice("imu", values, IMU_PRESETS)
            return cls.ideal() if values == "ideal" else cls()
        if not isinstance(values, dict):
            raise SpecError(f"imu={values!r} must be a preset ({', '.join(IMU_PRESETS)}) or a dict of ImuConfig fields")
        return super().from_dict(values)


_LIMITS: dict[str, tuple[float, float]] = {
    "accel_noise_density": (0.0, 1.0),
    "gyro_noise_density": (0.0, 1.0),
    "noise_scale": (0.0, 100.0),
    "accel_bias": (0.0, 5.0),
    "gyro_bias": (0.0, 1.0),
    "accel_bias_walk": (0.0, 1.0),
    "gyro_bias_walk": (0.0, 1.0),
    "accel_range": (10.0, 1000.0),
    "gyro_range": (0.1, 1000.0),
    "accel_quantum": (0.0, 1.0),
    "gyro_quantum": (0.0, 1.0),
}


class Imu:
    """Turns true motion into what the sensor reports, one sample or one control step's samples at a time.

    Accelerometer and gyroscope are sampled together, at whatever rate the caller samples the motion; the device's own
    250 and 400 Hz are close to the physics' 240.

    Args:
        config: what is wrong with the sensor.
        rng: draws biases and noise; one number is taken from it at each `reset`.
        dt: time between samples, seconds.
    """

    def __init__(self, config: ImuConfig, rng: np.random.Generator, dt: float = 1.0 / 240.0) -> None:
        self.config = config
        self._quantum = np.repeat([config.accel_quantum, config.gyro_quantum], 3)
        self._limit = np.repeat([_whole_steps(config.accel_range, config.accel_quantum), 0.0], 3)
        self._limit[3:] = _whole_steps(config.gyro_range, config.gyro_quantum)
        self.reset(rng, dt)

    def reset(self, rng: np.random.Generator, dt: float) -> None:
        """Begin an episode: draw other biases.

        Args:
            rng: one number is taken from it.
            dt: time between samples, seconds.

        Raises:
            SpecError: dt is out of range.
        """
        check_range("dt", dt, 1e-5, 1.0)
        config = self.config
        self._rng = np.random.default_rng(int(rng.integers(2**63)))
        self._bias = np.repeat([config.accel_bias, config.gyro_bias], 3) * self._rng.uniform(-1.0, 1.0, 6)
        densities = np.repeat([config.accel_noise_density, config.gyro_noise_density], 3)
        self._noise_std = densities * config.noise_scale / np.sqrt(dt)
        self._walk_std = np.repeat([config.accel_bias_walk, config.gyro_bias_walk], 3) * np.sqrt(dt)
        self._errors = np.empty((0, 6))
        self._next = 0

    def read(self, accel_true: np.ndarray, gyro_true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One sample.

        Args:
            accel_true: (3,) specific force in the sensor's axes, m/s^2.
            gyro_true: (3,) angular velocity in the sensor's axes, rad/s.

        Returns:
            The reported (3,) m/s^2 and (3,) rad/s, float64.
        """
        accel, gyro = self.read_many(np.reshape(accel_true, (1, 3)), np.reshape(gyro_true, (1, 3)))
        return accel[0], gyro[0]

    def read_many(self, accel_true: np.ndarray, gyro_true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Consecutive samples, the same as `read` one after the other.

        Args:
            accel_true: (k, 3) specific force in the sensor's axes, m/s^2.
            gyro_true: (k, 3) angular velocity in the sensor's axes, rad/s.

        Returns:
            The reported (k, 3) m/s^2 and (k, 3) rad/s, float64, new arrays.

        Raises:
            ValueError: the shapes are not equal and (k, 3).
        """
        accel_true, gyro_true = np.asarray(accel_true), np.asarray(gyro_true)
        if accel_true.ndim != 2 or accel_true.shape[1] != 3 or accel_true.shape != gyro_true.shape:
            raise ValueError(f"accel_true {accel_true.shape} and gyro_true {gyro_true.shape} must both be (k, 3)")
        samples = self.sample(np.concatenate([accel_true, gyro_true], axis=1))
        return samples[:, :3], samples[:, 3:]

    def sample(self, true: np.ndarray) -> np.ndarray:
        """Consecutive samples of both sensors side by side.

        Args:
            true: (k, 6) specific force, m/s^2, and angular velocity, rad/s, in the sensor's axes.

        Returns:
            What is reported: (k, 6) float64, a new array.
        """
        values = self._take_errors(len(true))
        values += true
        digitise(values, self._quantum, self._limit)
        return values

    def _take_errors(self, count: int) -> np.ndarray:
        """(count, 6) fresh copy of the next bias-plus-noise values."""
        if self._next + count <= len(self._errors):
            taken = self._errors[self._next : self._next + count].copy()
            self._next += count
            return taken
        parts = [self._errors[self._next :]]
        missing = count - len(parts[0])
        while missing > 0:
            self._errors = self._draw_block()
            parts.append(self._errors[:missing])
            self._next = len(parts[-1])
            missing -= self._next
        return np.concatenate(parts)

    def _draw_block(self) -> np.ndarray:
        """(_BLOCK, 6) bias, walking, plus white noise."""
        noise, walk = self._rng.standard_normal((2, _BLOCK, 6))
        bias = self._bias + np.cumsum(walk * self._walk_std, axis=0)
        self._bias = bias[-1]
        return bias + noise * self._noise_std


class MountedImu:
    """An inertial sensor fixed to the trunk, which samples at every physics step.

    Args:
        config: what is wrong with the sensor.
        lever_arm: (3,) sensor in the base frame, metres.
        sensor_to_base: (3, 3) rotation.
        rate_hz: of the physics.
        rng: draws biases and noise; two numbers are taken from it.
    """

    def __init__(
        self,
        config: ImuConfig,
        lever_arm: np.ndarray,
        sensor_to_base: np.ndarray,
        rate_hz: float,
        rng: np.random.Generator,
    ) -> None:
        self._lever_arm, self._sensor_to_base = lever_arm, sensor_to_base
        self._imu = Imu(config, rng, 1.0 / rate_hz)
        self._imu.reset(rng, 1.0 / rate_hz)  # a second draw, on which recorded rollouts depend

    def read_at_rest(self, up: np.ndarray, samples: int) -> np.ndarray:
        """Return samples of a trunk that stands.

        Args:
            up: (3,) unit vector against gravity, base frame.
            samples: how many.

        Returns:
            As `read`.
        """
        felt = np.zeros((samples, 6))
        felt[:, :3] = GRAVITY_M_S2 * (self._sensor_to_base.T @ up)
        return self._imu.sample(felt)

    def read(self, track: BaseTrack) -> np.ndarray:
        """Return the samples of a control step.

        Args:
            track: of the trunk over the step.

        Returns:
            (k, 6) float64, oldest first: specific force, m/s², and angular velocity, rad/s, in the sensor's axes.
        """
        return self._imu.sample(track.felt_at(self._lever_arm, self._sensor_to_base))


def specific_force(
    velocity_prev: np.ndarray,
    velocity_now: np.ndarray,
    dt: float,
    rotation_world_to_sensor: np.ndarray,
    gravity: np.ndarray | tuple[float, float, float] = (0.0, 0.0, -GRAVITY_M_S2),
) -> np.ndarray:
    """What an ideal accelerometer feels between two samples of its velocity.

    Args:
        velocity_prev, velocity_now: (..., 3) velocity of the sensor in the world frame, m/s.
        dt: time between them, seconds.
        rotation_world_to_sensor: (..., 3, 3).
        gravity: (3,) acceleration of free fall in the world frame, m/s^2.

    Returns:
        (..., 3) float64, acceleration minus gravity in the sensor's axes, m/s^2.
    """
    acceleration = (np.asarray(velocity_now, np.float64) - velocity_prev) / dt
    return (np.asarray(rotation_world_to_sensor) @ (acceleration - gravity)[..., None])[..., 0]


def sensor_point_velocity(
    base_velocity: np.ndarray, base_angular_velocity: np.ndarray, lever_arm: np.ndarray
) -> np.ndarray:
    """Velocity of a point fixed to a moving body, v + omega x r.

    Args:
        base_velocity: (..., 3) velocity of the body's origin, m/s.
        base_angular_velocity: (..., 3) rad/s.
        lever_arm: (..., 3) from the body's origin to the point, in the same frame as the velocities, metres.

    Returns:
        (..., 3) float64, m/s.
    """
    w, r = np.asarray(base_angular_velocity, np.float64), np.asarray(lever_arm, np.float64)
    x = w[..., 1] * r[..., 2] - w[..., 2] * r[..., 1]
    y = w[..., 2] * r[..., 0] - w[..., 0] * r[..., 2]
    z = w[..., 0] * r[..., 1] - w[..., 1] * r[..., 0]
    return base_velocity + np.stack([x, y, z], axis=-1)


def _whole_steps(limit: float, quantum: float) -> float:
    """The largest reading of a converter with the given step."""
    return np.floor(limit / quantum) * quantum if quantum > 0.0 else limit
