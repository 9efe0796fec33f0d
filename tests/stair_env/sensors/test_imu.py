import dataclasses
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stair_env.sensors.imu import GRAVITY_M_S2, Imu, ImuConfig, sensor_point_velocity, specific_force

DT = 1 / 240
IDEAL = ImuConfig.ideal()
# World (x forward, y left, z up) to a level camera that looks along world x.
WORLD_TO_CAMERA = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def only(seed=0, dt=DT, **changes) -> Imu:
    return Imu(dataclasses.replace(IDEAL, **changes), np.random.default_rng(seed), dt)


def zeros(count):
    return np.zeros((count, 3))


def record(imu, count):
    return imu.read_many(zeros(count), zeros(count))


# --- what it measures ------------------------------------------------------------------------------------------------


def test_at_rest_and_level_it_reads_gravity_upwards():
    felt = specific_force(np.zeros(3), np.zeros(3), DT, WORLD_TO_CAMERA)
    accel, gyro = only().read(felt, np.zeros(3))
    np.testing.assert_allclose(accel, (0.0, -GRAVITY_M_S2, 0.0), atol=1e-12)
    np.testing.assert_array_equal(gyro, 0.0)


def test_nose_down_turns_gravity_towards_minus_z():
    down = Rotation.from_euler("x", -0.4).as_matrix()  # camera axes in the level camera, nose down
    felt = specific_force(np.zeros(3), np.zeros(3), DT, down.T @ WORLD_TO_CAMERA)
    np.testing.assert_allclose(felt, (0.0, -GRAVITY_M_S2 * np.cos(0.4), -GRAVITY_M_S2 * np.sin(0.4)), atol=1e-12)


def test_free_fall_reads_nothing_and_speeding_up_reads_forward():
    fall = np.array([0.0, 0.0, -GRAVITY_M_S2 * DT])
    np.testing.assert_allclose(specific_force(np.zeros(3), fall, DT, WORLD_TO_CAMERA), 0.0, atol=1e-9)
    felt = specific_force(np.zeros(3), np.array([2.0 * DT, 0.0, 0.0]), DT, WORLD_TO_CAMERA)
    np.testing.assert_allclose(felt, (0.0, -GRAVITY_M_S2, 2.0), atol=1e-9)


def test_specific_force_of_a_trotting_sensor_matches_the_analytic_trajectory():
    """A body that bounces and pitches, the sensor 0.4 m ahead: velocities against exact derivatives."""
    lever, dt = np.array([0.4, 0.05, 0.1]), 1e-4
    times = np.arange(0.0, 1.0, dt)

    def pitch(t):
        return 0.15 * np.sin(12 * t)

    def body_to_world(t):
        return Rotation.from_rotvec(pitch(t)[:, None] * [0.0, 1.0, 0.0]).as_matrix()

    def velocity(t):
        return np.stack([0.5 + 0.1 * np.cos(9 * t), 0.2 * np.sin(5 * t), 0.3 * np.cos(15 * t)], axis=-1)

    rate = np.stack([0 * times, 0.15 * 12 * np.cos(12 * times), 0 * times], axis=-1)
    arm_world = body_to_world(times) @ lever
    point_velocity = sensor_point_velocity(velocity(times), rate, arm_world)
    world_to_sensor = WORLD_TO_CAMERA @ np.swapaxes(body_to_world(times), -1, -2)
    felt = specific_force(point_velocity[:-1], point_velocity[1:], dt, world_to_sensor[1:])

    middle = times[1:] - dt / 2  # finite differences of velocity belong to the middle of the interval
    body_acceleration = np.stack([-0.9 * np.sin(9 * middle), np.cos(5 * middle), -4.5 * np.sin(15 * middle)], axis=-1)
    omega = np.stack([0 * middle, 1.8 * np.cos(12 * middle), 0 * middle], axis=-1)
    alpha = np.stack([0 * middle, -21.6 * np.sin(12 * middle), 0 * middle], axis=-1)
    arm = body_to_world(middle) @ lever
    acceleration = body_acceleration + np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))
    expected = (world_to_sensor[1:] @ (acceleration + np.array([0.0, 0.0, GRAVITY_M_S2]))[..., None])[..., 0]
    assert np.abs(felt - expected).max() < 0.01 < np.ptp(expected, axis=0).min()


def test_point_velocity_is_the_derivative_of_the_points_position():
    rng = np.random.default_rng(0)
    velocity, omega, arm = rng.normal(size=(3, 7, 3))
    dt = 1e-6
    moved = dt * velocity + Rotation.from_rotvec(dt * omega).apply(arm)
    np.testing.assert_allclose(sensor_point_velocity(velocity, omega, arm), (moved - arm) / dt, atol=1e-4)


# --- what is wrong with it -------------------------------------------------------------------------------------------


def test_ideal_passes_motion_through():
    rng = np.random.default_rng(0)
    accel, gyro = rng.normal(0, 5, (20, 3)), rng.normal(0, 2, (20, 3))
    out = only().read_many(accel, gyro)
    np.testing.assert_array_equal(out[0], accel)
    np.testing.assert_array_equal(out[1], gyro)


def allan_deviation(values, dt, tau):
    size = round(tau / dt)
    means = values[: len(values) // size * size].reshape(-1, size, values.shape[1]).mean(axis=1)
    return np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2))


@pytest.mark.parametrize("rate_hz", [100.0, 240.0, 400.0])
def test_white_noise_has_the_data_sheets_density_at_any_rate(rate_hz):
    imu = only(dt=1 / rate_hz, accel_noise_density=1.47e-3, gyro_noise_density=2.44e-4)
    accel, gyro = record(imu, round(400 * rate_hz))
    assert accel.std() == pytest.approx(1.47e-3 * np.sqrt(rate_hz), rel=0.02)
    assert gyro.std() == pytest.approx(2.44e-4 * np.sqrt(rate_hz), rel=0.02)
    for tau in (0.1, 0.5, 2.0):  # density over the square root of the averaging time
        assert allan_deviation(accel, 1 / rate_hz, tau) == pytest.approx(1.47e-3 / np.sqrt(tau), rel=0.12)
        assert allan_deviation(gyro, 1 / rate_hz, tau) == pytest.approx(2.44e-4 / np.sqrt(tau), rel=0.12)


def test_bias_walks_with_the_square_root_of_time():
    walked = []
    for seed in range(60):
        accel, gyro = record(only(seed, accel_bias_walk=4e-4, gyro_bias_walk=7e-6), 2400)
        walked.append([accel[-1], gyro[-1]])
    spread = np.std(np.array(walked), axis=(0, 2))
    np.testing.assert_allclose(spread, np.array([4e-4, 7e-6]) * np.sqrt(2400 * DT), rtol=0.2)


def test_biases_are_drawn_at_reset_within_their_range():
    imu, rng, drawn = only(accel_bias=0.38, gyro_bias=0.0025), np.random.default_rng(1), []
    for _ in range(200):
        imu.reset(rng, DT)
        accel, gyro = record(imu, 3)
        np.testing.assert_array_equal(accel, accel[[0, 0, 0]])
        drawn.append(np.concatenate([accel[0] / 0.38, gyro[0] / 0.0025]))
    assert np.abs(drawn).max() <= 1.0 and np.std(drawn) == pytest.approx(1 / np.sqrt(3), rel=0.1)


def test_noise_scale_scales_white_noise_only():
    quiet = record(only(accel_noise_density=1e-3, accel_bias=0.1), 500)[0]
    loud = record(only(accel_noise_density=1e-3, accel_bias=0.1, noise_scale=10.0), 500)[0]
    bias = record(only(accel_bias=0.1), 1)[0]
    np.testing.assert_allclose(loud - bias, 10.0 * (quiet - bias), atol=1e-12)


def test_readings_come_in_whole_steps():
    imu = Imu(ImuConfig(), np.random.default_rng(0))
    rng = np.random.default_rng(1)
    accel, gyro = imu.read_many(rng.normal(0, 30, (500, 3)), rng.normal(0, 10, (500, 3)))
    for values, step in ((accel, 0.0192), (gyro, 5.3e-4)):
        np.testing.assert_allclose(values / step, np.rint(values / step), atol=1e-6)
    only_accel = only(accel_quantum=0.5).read([0.3, -0.3, 0.2], [0.3, -0.3, 0.2])
    np.testing.assert_allclose(only_accel[0], [0.5, -0.5, 0.0])
    np.testing.assert_allclose(only_accel[1], [0.3, -0.3, 0.2])


def test_readings_saturate_at_the_range():
    accel, gyro = Imu(ImuConfig(), np.random.default_rng(0)).read([500.0, -500.0, 0.0], [-90.0, 90.0, 0.0])
    np.testing.assert_allclose(accel[:2], [4 * 9.80665, -4 * 9.80665], atol=0.0192)
    np.testing.assert_allclose(gyro[:2], np.deg2rad([-1000.0, 1000.0]), atol=5.3e-4)
    assert np.abs(accel).max() <= 4 * 9.80665 and np.abs(gyro).max() <= np.deg2rad(1000.0)


# --- use -------------------------------------------------------------------------------------------------------------


def test_samples_are_the_same_one_by_one_and_together():
    rng = np.random.default_rng(0)
    accel, gyro = rng.normal(size=(2, 2600, 3))
    whole = Imu(ImuConfig(), np.random.default_rng(4)).read_many(accel, gyro)
    single, chunks = (Imu(ImuConfig(), np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(whole, np.swapaxes([single.read(a, g) for a, g in zip(accel, gyro)], 0, 1))
    cuts = np.cumsum(np.random.default_rng(2).integers(0, 400, 12))
    parts = [chunks.read_many(a, g) for a, g in zip(np.split(accel, cuts), np.split(gyro, cuts))]
    np.testing.assert_array_equal(whole, np.concatenate(parts, axis=1))


def test_inputs_and_earlier_outputs_are_not_changed():
    imu = Imu(ImuConfig(), np.random.default_rng(0))
    accel, gyro = zeros(5), zeros(5)
    first = [values.copy() for values in imu.read_many(accel, gyro)]
    kept = imu.read_many(accel, gyro)
    copies = [values.copy() for values in kept]
    imu.read_many(accel, gyro)
    assert not accel.any() and not gyro.any()
    np.testing.assert_array_equal(kept, copies)
    assert not np.array_equal(first, copies)


def test_a_seed_decides_everything_and_reset_takes_one_number():
    rng, other = np.random.default_rng(0), np.random.default_rng(0)
    imu = Imu(ImuConfig(), rng)
    other.integers(2**63)
    assert rng.bit_generator.state == other.bit_generator.state
    first = record(imu, 3000)
    assert rng.bit_generator.state == other.bit_generator.state
    imu.reset(np.random.default_rng(0), DT)
    np.testing.assert_array_equal(record(imu, 3000), first)
    imu.reset(np.random.default_rng(1), DT)
    assert not np.array_equal(record(imu, 3000), first)


@pytest.mark.parametrize("shapes", [((3,), (3,)), ((5, 3), (4, 3)), ((5, 2), (5, 2)), ((1, 5, 3), (1, 5, 3))])
def test_wrong_shapes_are_named(shapes):
    with pytest.raises(ValueError, match="accel_true"):
        only().read_many(np.zeros(shapes[0]), np.zeros(shapes[1]))


def test_config_round_trips_through_json():
    config = ImuConfig(noise_scale=3.0)
    assert ImuConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert ImuConfig.from_dict(None) == ImuConfig.from_dict("d435i") == ImuConfig()
    assert ImuConfig.from_dict("ideal") == IDEAL


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"noise_scale": -1}, "noise_scale=-1"),
        ({"gyro_range": 0}, "gyro_range=0"),
        ({"accel_noise": 1}, "imu field='accel_noise' must be one of 'accel_noise_density'"),
        ("mpu6050", "imu='mpu6050' must be one of 'd435i', 'ideal'"),
        (3, "imu=3"),
    ],
)
def test_wrong_config_names_field_value_and_choices(values, message):
    with pytest.raises(ValueError, match=message):
        ImuConfig.from_dict(values)


def test_wrong_dt_is_named():
    with pytest.raises(ValueError, match="dt"):
        only().reset(np.random.default_rng(0), 0.0)
