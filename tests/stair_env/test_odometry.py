import numpy as np
import pytest

from stair_env.attitude import AttitudeFilter, base_to_level
from stair_env.env import StairClimbEnv
from stair_env.kinematics import LegKinematics
from stair_env.odometry import LegOdometry
from stair_env.robots import get_robot


def test_standing_feet_tell_how_the_trunk_moves():
    robot = get_robot("aliengo")
    kinematics, odometry = LegKinematics(robot), LegOdometry(robot)
    feet, contact = robot.nominal_feet, np.ones(4, bool)
    odometry.update(kinematics.joint_angles(feet), contact, np.eye(3), 0.0, 0.02)
    moved = np.array([0.004, -0.002, 0.001])
    velocity = odometry.update(kinematics.joint_angles(feet - moved), contact, np.eye(3), 0.0, 0.02)
    # The round feet roll with the shank, which adds a few per cent forward.
    assert velocity[1:] == pytest.approx(moved[1:] / 0.02, abs=1e-9)
    assert velocity[0] == pytest.approx(0.2, rel=0.12)


def test_turning_on_the_spot_is_no_displacement():
    robot = get_robot("aliengo")
    kinematics, odometry = LegKinematics(robot), LegOdometry(robot)
    feet, turn = robot.nominal_feet, 0.01
    odometry.update(kinematics.joint_angles(feet), np.ones(4, bool), np.eye(3), 0.0, 0.02)
    back = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    velocity = odometry.update(kinematics.joint_angles(feet @ back.T), np.ones(4, bool), np.eye(3), turn, 0.02)
    assert velocity == pytest.approx(np.zeros(3), abs=1e-5)


def test_flying_keeps_the_last_velocity():
    robot = get_robot("aliengo")
    kinematics, odometry = LegKinematics(robot), LegOdometry(robot)
    joints = kinematics.joint_angles(robot.nominal_feet)
    odometry.update(joints, np.ones(4, bool), np.eye(3), 0.0, 0.02)
    before = odometry.update(joints + 0.01, np.ones(4, bool), np.eye(3), 0.0, 0.02).copy()
    assert np.array_equal(odometry.update(joints + 0.3, np.zeros(4, bool), np.eye(3), 0.0, 0.02), before)


def test_attitude_and_odometry_hold_on_a_walking_robot():
    env = StairClimbEnv(riser_height=0.1, num_steps=5)
    observation, info = env.reset(seed=4)
    travelled, tilt_errors = 0.0, []
    start = info["truth"]["position"][0]
    for _ in range(200):
        observation, _, done, _, info = env.step(np.zeros(16))
        velocity = observation["proprio"][6:9]
        travelled += float(velocity[0]) * np.cos(info["truth"]["yaw"]) / 48
        tilt_errors.append(np.degrees(np.arccos(np.clip(env._state.rotation[2] @ env._attitude.up, -1, 1))))
        if done:
            break
    distance = info["truth"]["position"][0] - start
    env.close()
    assert distance > 1.0
    assert travelled == pytest.approx(distance, rel=0.15)
    assert np.sqrt(np.mean(np.square(tilt_errors))) < 1.0


def test_filter_starts_where_the_accelerometer_points():
    up = np.array([0.2, -0.1, 0.9])
    up /= np.linalg.norm(up)
    attitude = AttitudeFilter(240.0)
    attitude.reset(9.81 * up)
    assert attitude.up == pytest.approx(up, abs=1e-6)
    assert base_to_level(attitude.up) @ up == pytest.approx([0, 0, 1], abs=1e-6)
    with pytest.raises(ValueError, match="direction"):
        attitude.reset(np.zeros(3))
