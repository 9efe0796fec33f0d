import numpy as np
import pytest

from stair_env.observation import NO_STAIRS, StairBlock
from stair_env.onboard.gait import ACTION_SIZE, Gait, GaitAction, GaitConfig
from stair_env.onboard.kinematics import LegKinematics
from stair_env.robots import ROBOTS, get_robot

DT = 1 / 48
ZERO = np.zeros(ACTION_SIZE)


def swing_heights(block, steps=80, action=ZERO):
    """Lowest and highest foot over a walk, base frame, on the spot where odometry says nothing moves."""
    robot = get_robot("aliengo")
    gait, kinematics = Gait(robot), LegKinematics(robot)
    gait.reset(np.zeros(4))
    feet = [kinematics.foot_positions(gait.joint_targets(action, block, np.zeros(3), DT)) for _ in range(steps)]
    return np.array(feet)


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_walks_within_reach_and_lifts_every_foot(name):
    robot = ROBOTS[name]
    gait, kinematics = Gait(robot), LegKinematics(robot)
    gait.reset(np.zeros(4))
    feet = np.array(
        [kinematics.foot_positions(gait.joint_targets(ZERO, NO_STAIRS, np.array([0.35, 0, 0]), DT)) for _ in range(96)]
    )
    lift = feet[:, :, 2].max(axis=0) - feet[:, :, 2].min(axis=0)
    assert (lift > 0.9 * GaitConfig().unknown_clearance).all()
    assert feet[:, :, 2].min() == pytest.approx(-robot.stand_height, abs=0.01)


def test_without_stairs_it_steps_higher_than_with_them():
    far = StairBlock(1.0, 1.0, 0.3, 0.12, 2.0, 0.0, 0.0, 1.0)
    known, unknown = swing_heights(far), swing_heights(NO_STAIRS)
    assert unknown[..., 2].max() > known[..., 2].max() + 0.03


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_plans_footholds_on_the_treads_clear_of_nosings(direction):
    """Walk a perfect robot along perfect stairs: every foothold stands on the right level, away from edges."""
    robot, config = get_robot("aliengo"), GaitConfig()
    gait = Gait(robot, config)
    gait.reset(np.zeros(4))
    edges = 0.9 + 0.3 * np.arange(5)  # ahead of the base at the start
    travelled, last = 0.0, np.zeros(4)
    checked = 0
    for _ in range(260):
        hip = travelled + robot.hip_x[0]
        ahead = edges[edges > hip]
        block = StairBlock(1.0, direction, 0.3, 0.12, ahead[0] - hip, 0, 0, 1) if len(ahead) else NO_STAIRS
        before = np.array(gait._feet)[:, 0] + travelled
        gait.joint_targets(ZERO, block, np.array([(travelled - last[0]) / DT, 0, 0]), DT)
        last[0] = travelled
        standing = ~np.array(gait._in_swing)
        where = np.array(gait._feet)[:, 0] + travelled  # the frame has moved on by what this step's speed covers
        moved = float(np.median((before - where)[standing])) if standing.any() else 0.0
        travelled += moved
        where = where + moved
        for leg in np.flatnonzero(standing):
            level = direction * 0.12 * (edges < where[leg]).sum()
            gap = np.abs(edges - where[leg]).min()
            assert gap > config.nosing_margin - 0.02
            assert gait._feet[leg][2] == pytest.approx(level, abs=1e-6)
            checked += 1
    assert checked > 300 and travelled > 1.0


def test_action_scales_are_the_documented_ones():
    config = GaitConfig()
    scaled = GaitAction.from_array(np.ones(ACTION_SIZE), config)
    assert scaled.feet == pytest.approx(np.full((4, 3), 0.06))
    assert (scaled.speed, scaled.frequency, scaled.pitch) == pytest.approx((1.3, 1.2, 0.15))


def test_residuals_are_low_passed():
    robot = get_robot("aliengo")
    kinematics = LegKinematics(robot)
    quiet, pushed = Gait(robot), Gait(robot)
    push = ZERO.copy()
    push[0] = 1.0
    still, moved = (
        kinematics.foot_positions(gait.joint_targets(action, NO_STAIRS, np.zeros(3), DT))
        for gait, action in ((quiet, ZERO), (pushed, push))
    )
    assert (moved - still)[0, 0] == pytest.approx(0.4 * 0.06, abs=1e-6)


def test_turns_towards_the_stairs():
    robot = get_robot("aliengo")
    gait = Gait(robot)
    gait.reset(np.zeros(4))
    left = StairBlock(1.0, 1.0, 0.3, 0.12, 2.0, heading_error=0.3, age=0.0, confidence=1.0)
    start = np.array(gait._feet)
    gait.joint_targets(ZERO, left, np.zeros(3), DT)
    moved = np.array(gait._feet) - start
    standing = ~np.array(gait._in_swing)
    # Turning left, feet on the ground turn right in the robot's frame: those in front go right, those behind left.
    assert (np.sign(moved[standing, 1]) == -np.sign(start[standing, 0])).all()
