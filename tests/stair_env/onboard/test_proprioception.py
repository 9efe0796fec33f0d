import numpy as np
import pytest

from stair_env.env import StairClimbEnv
from stair_env.observation import PROPRIO_SLICES, proprio_space
from stair_env.onboard.gait import ACTION_SIZE, Gait
from stair_env.onboard.kinematics import LegKinematics
from stair_env.onboard.proprioception import (
    MAX_CORRECTION_M_S,
    AttitudeFilter,
    LegOdometry,
    Proprioception,
    base_to_level,
)
from stair_env.robots import get_robot

REST = np.array([0.0, 0.0, 9.80665])  # what an accelerometer reads that nothing moves
DT = 1 / 48
STANDING, FLYING = np.ones(4, bool), np.zeros(4, bool)


def walk(odometry: LegOdometry, moved: np.ndarray, steps: int, turn: float = 0.0) -> np.ndarray:
    """The trunk moves by `moved` in each step over feet that stand; the feet are put back under it now and then."""
    kinematics, nominal = LegKinematics(get_robot("aliengo")), get_robot("aliengo").nominal_feet
    back = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    velocity = np.zeros(3)
    for step in range(steps):
        if step % 5 == 0:  # lifted, and set down again
            feet = nominal
            velocity = odometry.update(kinematics.joint_angles(feet), FLYING, REST, np.eye(3), turn, DT)
        feet = (feet - moved) @ back.T
        velocity = odometry.update(kinematics.joint_angles(feet), STANDING, REST, np.eye(3), turn, DT)
    return velocity


def test_standing_feet_tell_how_the_trunk_moves():
    moved = np.array([0.004, -0.002, 0.001])
    velocity = walk(LegOdometry(get_robot("aliengo")), moved, 60)
    # The round feet roll with the shank, which adds a few per cent forward.
    assert velocity[1:] == pytest.approx(moved[1:] / DT, abs=1e-3)
    assert velocity[0] == pytest.approx(moved[0] / DT, rel=0.12)


def test_turning_on_the_spot_is_no_displacement():
    velocity = walk(LegOdometry(get_robot("aliengo")), np.zeros(3), 30, turn=0.01)
    assert velocity == pytest.approx(np.zeros(3), abs=1e-3)


def test_flying_feels_the_accelerometer_alone():
    robot = get_robot("aliengo")
    joints, odometry = LegKinematics(robot).joint_angles(robot.nominal_feet), LegOdometry(robot)
    odometry.update(joints, STANDING, REST, np.eye(3), 0.0, DT)
    velocity = odometry.update(joints + 0.3, FLYING, REST + np.array([2.0, -1.0, 0.5]), np.eye(3), 0.0, DT)
    assert velocity == pytest.approx(np.array([2.0, -1.0, 0.5]) * DT, abs=1e-9)
    turned = odometry.update(joints, FLYING, REST, np.eye(3), np.pi / 2, DT)
    assert turned == pytest.approx(np.array([-1.0, -2.0, 0.5]) * DT, abs=1e-9)


def test_a_foot_that_bounces_is_hardly_believed():
    robot = get_robot("aliengo")
    joints, odometry = LegKinematics(robot).joint_angles(robot.nominal_feet), LegOdometry(robot)
    odometry.update(joints, STANDING, REST, np.eye(3), 0.0, DT)
    velocity = odometry.update(joints + 0.1, STANDING, REST, np.eye(3), 0.0, DT)
    assert 0.0 < np.linalg.norm(velocity) <= MAX_CORRECTION_M_S + 1e-9


def test_attitude_and_odometry_hold_on_a_walking_robot():
    env = StairClimbEnv(riser_height=0.1, num_steps=5)
    observation, info = env.reset(seed=4)
    travelled, tilt_errors = 0.0, []
    start = info["truth"]["position"][0]
    for _ in range(200):
        observation, _, done, _, info = env.step(np.zeros(16))
        velocity = observation["proprio"][6:9]
        travelled += float(velocity[0]) * np.cos(info["truth"]["yaw"]) / 48
        cosine = env.state.after.rotation[2] @ -observation["proprio"][:3]
        tilt_errors.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
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


def test_a_standing_robot_knows_that_it_stands_and_its_block_lies_in_the_space():
    robot, pitch = get_robot("aliengo"), 0.2
    joints = LegKinematics(robot).joint_angles(robot.nominal_feet)
    rest = 9.81 * np.array([-np.sin(pitch), 0.0, np.cos(pitch)])
    imu = np.tile([*rest, 0.0, 0.0, 0.0], (5, 1))
    sense, gait = Proprioception(robot, 240.0), Gait(robot)
    sense.reset(rest)
    gait.reset(sense.foot_heights(joints))
    for _ in range(50):
        sense.update(imu, joints, STANDING, DT)
    assert np.abs(sense.velocity).max() < 0.02
    block = sense.block(joints, np.zeros(12), joints, STANDING, gait, np.zeros(ACTION_SIZE))
    assert block.dtype == np.float32 and proprio_space().contains(block)
    np.testing.assert_allclose(block[PROPRIO_SLICES["gravity"]], -rest / 9.81, atol=2e-3)
    assert not block[PROPRIO_SLICES["joint_error"]].any() and block[PROPRIO_SLICES["contact"]].all()


def test_feet_below_a_pitched_trunk_are_level_again():
    robot = get_robot("aliengo")
    joints, sense = LegKinematics(robot).joint_angles(robot.nominal_feet), Proprioception(robot, 240.0)
    sense.reset(REST)
    assert np.abs(sense.foot_heights(joints)).max() < 1e-6
    sense.reset(9.81 * np.array([np.sin(0.2), 0.0, np.cos(0.2)]))  # nose up
    heights = sense.foot_heights(joints)
    assert abs(heights[1]) < 1e-6 and heights[2] < -0.05  # the rear feet stand lower
