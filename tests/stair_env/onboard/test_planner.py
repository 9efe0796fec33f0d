import numpy as np
import pytest

from stair_env.common.validation import SpecError
from stair_env.observation import NO_STAIRS, StairBlock
from stair_env.onboard.gait import Gait, GaitConfig
from stair_env.onboard.kinematics import LegKinematics
from stair_env.onboard.planner import JOINT_ACTION_RAD, PLANNER_PARTS, JointActuation, JointOffsets, make_planner
from stair_env.robots import get_robot

ROBOT = get_robot("aliengo")


def test_names_configs_classes_functions_and_objects():
    own = Gait(ROBOT)
    config = GaitConfig(flat_speed=0.2)
    assert make_planner("trot", "gait", ROBOT).config == GaitConfig()
    assert make_planner(config, "gait", ROBOT).config is config
    assert isinstance(make_planner(Gait, "gait", ROBOT), Gait)
    assert make_planner(lambda robot: Gait(robot, config), "gait", ROBOT).config is config
    copied = make_planner(own, "gait", ROBOT)
    assert isinstance(copied, Gait) and copied is not own


def test_both_planners_have_what_the_environment_asks_for():
    for planner in (make_planner("trot", "gait", ROBOT), make_planner("trot", "joint", ROBOT)):
        assert all(hasattr(planner, part) for part in PLANNER_PARTS)
        assert planner.foothold_heights.shape == (4,)


def test_joint_offsets_start_from_standing():
    planner = JointOffsets(ROBOT)
    planner.reset(np.zeros(4), phase=0.25)
    standing = LegKinematics(ROBOT).joint_angles(ROBOT.nominal_feet)
    targets = planner.joint_targets(np.full(12, 0.5), NO_STAIRS, np.zeros(3), 1 / 48)
    assert targets == pytest.approx(standing + np.tile(JOINT_ACTION_RAD, 4) / 2) and planner.phase == 0.0  # no clock


def test_actions_and_joint_targets_belong_together():
    planner = make_planner("trot", {"scale": [0.3, 1.0, 0.8], "pose": [0.0, 0.8, -1.6]}, ROBOT)
    action = np.linspace(-1.0, 1.0, 12)
    targets = planner.joint_targets(action, NO_STAIRS, np.zeros(3), 1 / 48)
    assert planner.action_for(targets) == pytest.approx(action)
    assert planner.joint_targets(np.zeros(12), NO_STAIRS, np.zeros(3), 1 / 48) == pytest.approx([0.0, 0.8, -1.6] * 4)
    assert np.abs(planner.action_for(targets + 9.0)).max() == 1.0


def test_joint_actions_reach_what_the_gait_asks_for_on_steep_stairs():
    """The gait's targets over a riser of 0.20 m, from standing, within what actions of ±1 reach."""
    gait, joints = Gait(ROBOT), JointOffsets(ROBOT)
    block = StairBlock(1.0, 1.0, 0.28, 0.20, 0.2, 0.0, 0.0, 1.0)
    for _ in range(48):
        targets = gait.joint_targets(np.zeros(16), block, np.zeros(3), 1 / 48)
        assert np.abs((targets - joints.pose) / joints.scale).max() < 1.0


def test_a_clock_keeps_time():
    planner = make_planner("trot", JointActuation(clock_hz=2.0), ROBOT)
    planner.reset(np.zeros(4), phase=0.9)
    for _ in range(12):
        planner.joint_targets(np.zeros(12), NO_STAIRS, np.zeros(3), 1 / 48)
    assert planner.phase == pytest.approx(0.4)


@pytest.mark.parametrize("fields", [{"scale": 4.0}, {"scale": [1.0, 1.0]}, {"pose": [9.0] * 12}, {"clock_hz": -1.0}])
def test_wrong_joint_actuation_is_named(fields):
    with pytest.raises(SpecError, match=f"actuation.{next(iter(fields))}"):
        make_planner("trot", fields, ROBOT)


def test_legs_swing_at_the_offsets_of_the_config():
    config = GaitConfig(swing_fraction=0.25, leg_offsets=(0.0, 0.5, 0.25, 0.75))
    gait, aloft = Gait(ROBOT, config), []
    start = gait.joint_targets(np.zeros(16), NO_STAIRS, np.zeros(3), 1 / 48)
    kinematics = LegKinematics(ROBOT)
    ground = kinematics.foot_positions(start)[:, 2].min()
    for _ in range(60):
        feet = kinematics.foot_positions(gait.joint_targets(np.zeros(16), NO_STAIRS, np.zeros(3), 1 / 48))
        aloft.append((feet[:, 2] > ground + 0.02).sum())
    assert max(aloft) == 1


@pytest.mark.parametrize("gait", ["gallop", 3, object(), lambda robot: robot])
def test_wrong_gaits_are_named(gait):
    with pytest.raises(SpecError, match=r"gait=.*'trot'"):
        make_planner(gait, "gait", ROBOT)


def test_actuation_is_checked():
    with pytest.raises(SpecError, match=r"actuation='wheels'.*joint"):
        make_planner("trot", "wheels", ROBOT)
    with pytest.raises(SpecError, match="actuation"):
        make_planner(GaitConfig(), "joint", ROBOT)
