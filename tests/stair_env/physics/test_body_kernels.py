"""The compiled loops against the plain formulas."""

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

from stair_env.common.constants import GRAVITY_M_S2
from stair_env.physics.body_kernels import (
    TRACK_WIDTH,
    digitise,
    displacement,
    feel,
    forward_legs,
    inverse_legs,
    level_stance,
    level_turn,
    trace_trunk,
)
from stair_env.sensors.imu import sensor_point_velocity, specific_force

HIPS = np.array([[0.24, -0.05, 0.0], [0.24, 0.05, 0.0], [-0.24, -0.05, 0.0], [-0.24, 0.05, 0.0]])
SIDES = np.array([-0.08, 0.08, -0.08, 0.08])
LINKS = np.array([0.25, 0.22])
RATE_HZ = 240.0


def leg_plane_feet(angles):
    """Feet by rotating each leg's plane about its hip, one leg at a time."""
    feet = []
    for (abduction, upper, lower), hip, side in zip(angles.reshape(4, 3), HIPS, SIDES):
        thigh = Rotation.from_euler("y", upper).apply([0.0, 0.0, -LINKS[0]])
        shank = Rotation.from_euler("y", upper + lower).apply([0.0, 0.0, -LINKS[1]])
        feet.append(hip + Rotation.from_euler("x", abduction).apply(thigh + shank + [0.0, side, 0.0]))
    return np.array(feet)


def random_track(rng, count):
    track = rng.normal(size=(count, TRACK_WIDTH))
    track[:, 3:12] = Rotation.random(count, random_state=rng).as_matrix().reshape(count, 9)
    return track


@pytest.mark.parametrize("seed", range(5))
def test_legs_are_chains_of_rotations(seed):
    angles = np.random.default_rng(seed).uniform([-0.5, -0.3, -2.2], [0.5, 1.3, -0.6], (4, 3)).ravel()
    feet = forward_legs(angles, HIPS, SIDES, LINKS)
    np.testing.assert_allclose(feet, leg_plane_feet(angles), atol=1e-14)
    np.testing.assert_allclose(inverse_legs(feet, HIPS, SIDES, LINKS, 0.05, 0.47), angles, atol=1e-9)


def test_a_foot_out_of_reach_is_pulled_in_along_its_line():
    far = HIPS + np.stack([np.full(4, 0.4), SIDES, np.full(4, -0.8)], axis=1)
    reached = forward_legs(inverse_legs(far, HIPS, SIDES, LINKS, 0.05, 0.45), HIPS, SIDES, LINKS)
    line = (reached - HIPS)[:, [0, 2]]
    np.testing.assert_allclose(np.hypot(*line.T), 0.45, atol=1e-12)
    np.testing.assert_allclose(line[:, 0] / line[:, 1], -0.5, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_levelling_takes_pitch_and_roll_out_and_leaves_the_heading(seed):
    yaw, pitch, roll = np.random.default_rng(seed).uniform(-1, 1, 3)
    base_to_world = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    levelled = Rotation.from_euler("z", yaw).as_matrix() @ level_turn(base_to_world[2].copy())
    np.testing.assert_allclose(levelled, base_to_world, atol=1e-14)


def test_stances_are_seen_without_pitch_and_roll():
    angles, pitch = np.random.default_rng(0).uniform(-1, 1, 12), 0.3
    turn = Rotation.from_euler("y", pitch).as_matrix()
    stance = level_stance(angles, HIPS, SIDES, LINKS, turn)
    np.testing.assert_allclose(stance[:, :3], leg_plane_feet(angles) @ turn.T, atol=1e-14)
    np.testing.assert_allclose(stance[:, 3], pitch + angles[1::3] + angles[2::3], atol=1e-15)


@pytest.mark.parametrize("standing", [[1, 1, 1, 1], [1, 0, 1, 1], [0, 1, 1, 0], [0, 0, 0, 1]])
def test_displacement_is_the_median_of_the_standing_feet(standing):
    rng, yaw_change, radius = np.random.default_rng(sum(standing)), 0.2, 0.03
    before, after, standing = rng.normal(size=(4, 4)), rng.normal(size=(4, 4)), np.array(standing, bool)
    turned = before[:, :3] @ Rotation.from_euler("z", yaw_change).as_matrix()
    moved = turned - after[:, :3]
    moved[:, 0] += radius * (after[:, 3] - before[:, 3])
    expected = np.median(moved[standing], axis=0)
    for touched, touching in ((standing, np.ones(4, bool)), (np.ones(4, bool), standing)):
        found = displacement(before, after, touched, touching, yaw_change, radius)
        np.testing.assert_allclose(found, expected, atol=1e-15)
    assert np.isnan(displacement(before, after, standing, ~standing, yaw_change, radius)).all()


@pytest.mark.parametrize("seed", range(5))
def test_the_trunk_moves_as_a_rigid_body(seed):
    rng = np.random.default_rng(seed)
    readings = rng.normal(size=(4, 13))
    to_base, origin = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
    track = trace_trunk(readings, to_base, origin)
    for reading, row in zip(readings, track):
        rotation = np.reshape(pybullet.getMatrixFromQuaternion(reading[3:7] / np.linalg.norm(reading[3:7])), (3, 3))
        offset = rotation @ to_base @ origin
        np.testing.assert_allclose(row[:3], reading[:3] + offset, atol=1e-12)
        np.testing.assert_allclose(row[3:12].reshape(3, 3), rotation @ to_base, atol=1e-12)
        np.testing.assert_allclose(row[12:15], reading[7:10] + np.cross(reading[10:], offset), atol=1e-12)
        np.testing.assert_array_equal(row[15:], reading[10:])


@pytest.mark.parametrize("seed", range(5))
def test_sensors_feel_what_the_formulas_say(seed):
    rng = np.random.default_rng(seed)
    track, lever = random_track(rng, 6), rng.normal(size=3)
    sensor_to_base = Rotation.random(random_state=rng).as_matrix()
    felt = feel(track[0], track[1:], lever, sensor_to_base.ravel(), RATE_HZ, GRAVITY_M_S2)
    rotations = track[:, 3:12].reshape(-1, 3, 3)
    velocities = sensor_point_velocity(track[:, 12:15], track[:, 15:], rotations @ lever)
    world_to_sensor = np.swapaxes(rotations[1:] @ sensor_to_base, 1, 2)
    force = specific_force(velocities[:-1], velocities[1:], 1 / RATE_HZ, world_to_sensor, (0.0, 0.0, -GRAVITY_M_S2))
    np.testing.assert_allclose(felt[:, :3], force, atol=1e-9)
    np.testing.assert_allclose(felt[:, 3:], (world_to_sensor @ track[1:, 15:, None])[..., 0], atol=1e-12)


def test_values_become_whole_steps_within_the_range():
    values = np.array([[0.26, 0.26, 9.0, -9.0], [-0.24, -0.24, 1.1, 1.1]])
    digitise(values, np.array([0.5, 0.0, 0.5, 0.0]), np.array([4.0, 4.0, 4.0, 4.0]))
    np.testing.assert_allclose(values, [[0.5, 0.26, 4.0, -4.0], [0.0, -0.24, 1.0, 1.1]])
