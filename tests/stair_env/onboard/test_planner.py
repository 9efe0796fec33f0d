import numpy as np
import pytest

from stair_env.common.validation import SpecError
from stair_env.observation import NO_STAIRS
from stair_env.onboard.gait import Gait, GaitConfig
from stair_env.onboard.kinematics import LegKinematics
from stair_env.onboard.planner import JOINT_ACTION_RAD, PLANNER_PARTS, JointOffsets, make_planner
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
    assert targets == pytest.approx(standing + JOINT_ACTION_RAD / 2) and planner.phase == 0.25


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
