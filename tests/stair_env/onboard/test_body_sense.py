"""A standing robot knows that it stands; the block it makes lies in the environment's space."""

from __future__ import annotations

import numpy as np

from stair_env.observation import PROPRIO_SLICES, proprio_space
from stair_env.onboard.body_sense import BodyReading, BodySense
from stair_env.onboard.gait import ACTION_SIZE, Gait
from stair_env.onboard.kinematics import LegKinematics
from stair_env.robots import get_robot

ROBOT = get_robot("aliengo")
JOINTS = LegKinematics(ROBOT).joint_angles(ROBOT.nominal_feet)


def reading(time_s: float, imu: np.ndarray) -> BodyReading:
    return BodyReading(time_s, JOINTS, np.zeros(12), np.ones(4, bool), imu)


def test_a_standing_robot_stands() -> None:
    pitch = 0.2
    rest = 9.81 * np.array([-np.sin(pitch), 0.0, np.cos(pitch)])
    imu = np.tile([*rest, 0.0, 0.0, 0.0], (5, 1))
    sense, gait = BodySense(ROBOT), Gait(ROBOT)
    sense.begin(reading(0.0, imu))
    gait.reset(sense.foot_heights(JOINTS))
    for step in range(1, 50):
        sense.update(reading(step / 48, imu))
    assert np.abs(sense.velocity).max() < 0.02
    block = sense.proprio(reading(1.0, imu), JOINTS, gait, np.zeros(ACTION_SIZE))
    assert block.dtype == np.float32 and proprio_space().contains(block)
    np.testing.assert_allclose(block[PROPRIO_SLICES["gravity"]], -rest / 9.81, atol=2e-3)
    assert not block[PROPRIO_SLICES["joint_error"]].any() and block[PROPRIO_SLICES["contact"]].all()


def test_feet_below_a_pitched_trunk_are_level_again() -> None:
    level = BodySense(ROBOT)
    level.begin(reading(0.0, np.tile([0.0, 0.0, 9.81, 0.0, 0.0, 0.0], (5, 1))))
    assert np.abs(level.foot_heights(JOINTS)).max() < 1e-6
    nose_up = BodySense(ROBOT)
    nose_up.begin(reading(0.0, np.tile([9.81 * np.sin(0.2), 0.0, 9.81 * np.cos(0.2), 0.0, 0.0, 0.0], (5, 1))))
    heights = nose_up.foot_heights(JOINTS)
    assert abs(heights[1]) < 1e-6 and heights[2] < -0.05  # the rear feet stand lower
