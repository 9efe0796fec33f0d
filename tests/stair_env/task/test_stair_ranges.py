import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stair_env.common.validation import SpecError
from stair_env.robots import get_robot
from stair_env.stairs import StairSpec
from stair_env.task.curriculum import Curriculum, CurriculumConfig, read_curriculum
from stair_env.task.randomization import read_randomization
from stair_env.task.spawn import draw_spawn, standing_at
from stair_env.task.stair_ranges import StairRanges


@given(st.integers(0, 10_000))
def test_drawn_stairs_lie_in_their_ranges(seed):
    ranges = StairRanges("both", (0.1, 0.15), (0.26, 0.3), (3, 6), uneven=0.01)
    spec = ranges.draw(np.random.default_rng(seed), None)
    assert spec.direction in ("up", "down")
    assert 0.1 <= spec.riser_height <= 0.15 and 0.26 <= spec.tread_depth <= 0.3 and 3 <= spec.num_steps <= 6
    assert np.abs(spec.riser_offsets).max() <= 0.01
    assert spec == ranges.draw(np.random.default_rng(seed), None)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("riser_height", -1),
        ("riser_height", (0.2, 0.1)),
        ("riser_height", (0.1, 0.12, 0.14)),
        ("riser_height", "high"),
        ("num_steps", 2.5),
        ("direction", "sideways"),
        ("tread_depth", True),
    ],
)
def test_wrong_ranges_are_named(field, value):
    with pytest.raises(SpecError, match=field):
        StairRanges(**{field: value})


def test_curriculum_promotes_demotes_and_survives_a_checkpoint():
    curriculum = Curriculum(CurriculumConfig(start=0.05, levels=4, window=5), highest=0.17)
    for _ in range(5):
        curriculum.report(True)
    assert curriculum.level == 1 and curriculum.riser_height == pytest.approx(0.08)
    twin = Curriculum(curriculum.config, curriculum.highest)
    twin.restore(curriculum.state())
    for _ in range(5):
        curriculum.report(False)
        twin.report(False)
    assert curriculum.level == twin.level == 0
    for _ in range(5):
        curriculum.report(False)
    assert curriculum.level == 0
    for _ in range(100):
        curriculum.report(True)
    assert curriculum.level == 4 and curriculum.riser_height == pytest.approx(0.17)


@given(st.integers(0, 999), st.integers(0, 14))
def test_curriculum_never_draws_above_its_level(seed, level):
    curriculum = Curriculum(CurriculumConfig(), highest=0.17)
    curriculum.level = level
    assert 0.02 <= curriculum.draw_riser(0.1, np.random.default_rng(seed)) <= curriculum.riser_height + 1e-12


def test_options_name_what_is_wrong():
    assert read_curriculum(None, 0.2) is None
    assert read_randomization(None).push_speed == 0.0
    assert read_randomization(True).push_speed > 0.0
    with pytest.raises(SpecError, match="promote"):
        read_curriculum({"promotion": 0.5}, 0.2)
    with pytest.raises(SpecError, match="friction"):
        read_randomization({"friction": (2.0, 1.0)})
    with pytest.raises(SpecError, match="randomization"):
        read_randomization("lots")


@given(st.integers(0, 999), st.sampled_from(["up", "down"]))
def test_robots_start_with_their_feet_on_the_ground_clear_of_edges(seed, direction):
    spec, robot = StairSpec(direction=direction, riser_height=0.14), get_robot("aliengo")
    spawn = draw_spawn(spec, robot, "anywhere", np.random.default_rng(seed))
    pitch, yaw = spawn.pitch, spawn.yaw
    tip = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    feet = spawn.position + spawn.feet_in_base @ (turn @ tip).T
    profile = spec.profile()
    assert feet[:, 2] == pytest.approx(profile.height_at(feet[:, 0]) + robot.foot_radius, abs=1e-9)
    assert np.abs(feet[:, 0, None] - profile.edge_x).min() > 0.05


def test_standing_where_asked():
    spawn = standing_at(StairSpec(), get_robot("a1"), -1.0, 0.2, 0.1)
    assert spawn.position[:2] == pytest.approx([-1.0, 0.2]) and spawn.yaw == 0.1
