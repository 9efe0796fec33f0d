import math

import numpy as np
import pytest

from stair_env.physics.simulation import BaseState
from stair_env.robots import get_robot
from stair_env.stairs import StairSpec
from stair_env.task.termination import FAILURES, FALL_COSINE, WALKED_AWAY_M, Judge

ROBOT = get_robot("aliengo")
STAIRS = StairSpec(direction="up", riser_height=0.15, tread_depth=0.3, num_steps=4)
PROFILE = STAIRS.profile()
START_X = -0.8
LAST_EDGE, TOP = float(PROFILE.edge_x[-1]), float(PROFILE.level_z[-1])


def judge():
    return Judge(STAIRS, PROFILE, ROBOT, START_X)


def base(x, y=0.0, above=ROBOT.stand_height, tilt=0.0):
    cos, sin = math.cos(tilt), math.sin(tilt)
    rotation = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    return BaseState(np.array([x, y, PROFILE.level_under(x) + above]), rotation, np.zeros(3), np.zeros(3))


def standing(x):
    """Feet under a base at x, each on the ground."""
    places = [x + dx for dx in (0.24, 0.24, -0.24, -0.24)]
    return [[place, 0.0, PROFILE.level_under(place)] for place in places]


def verdict(x, **changes):
    return judge().termination(base(x, **changes), standing(x))


def test_a_robot_under_way_goes_on():
    assert {verdict(float(x)) for x in np.linspace(START_X, LAST_EDGE, 40)} == {""}


def test_success_is_both_rear_feet_on_the_landing_and_upright():
    assert verdict(LAST_EDGE + 0.3) == "success"
    assert verdict(LAST_EDGE + 0.2) == ""
    assert verdict(LAST_EDGE + 0.3, tilt=0.8) == ""
    feet = standing(LAST_EDGE + 0.3)
    feet[2][2] = TOP - 0.3
    assert judge().termination(base(LAST_EDGE + 0.3), feet) == ""


@pytest.mark.parametrize(
    ("reason", "changes"),
    [
        ("fall", {"tilt": math.acos(FALL_COSINE) + 0.01}),
        ("fall", {"above": 0.3 * ROBOT.stand_height}),
        ("fall", {"above": math.nan}),
        ("left_flight", {"y": STAIRS.flight_width / 2 + 0.01}),
    ],
)
def test_failures_are_named(reason, changes):
    assert verdict(0.4, **changes) == reason and reason in FAILURES


def test_walking_back_is_a_failure_and_beside_the_stairs_is_none_before_them():
    assert verdict(START_X - WALKED_AWAY_M - 0.01) == "walked_away"
    assert verdict(START_X, y=2.0) == ""


def test_steps_behind_count_edges():
    assert [judge().steps_behind(x) for x in (-0.5, 0.1, 0.4, LAST_EDGE + 1)] == [0, 1, 2, 4]


def test_slope_is_that_of_the_ground():
    assert judge().local_slope(standing(-0.6)) == 0.0
    feet = [[x, 0.0, 0.0] for x in (0.01, 0.01, -0.01, -0.01)]
    assert math.tan(judge().local_slope(feet)) == pytest.approx(0.15 / (ROBOT.hip_x[0] - ROBOT.hip_x[1]))


def test_a_profile_answers_one_number_like_many():
    profile = StairSpec(direction="up_down", num_steps=3, tread_offsets=(0.01, -0.01, 0.0)).profile()
    places = np.concatenate([np.random.default_rng(0).uniform(-1, 4, 200), profile.edge_x])
    np.testing.assert_array_equal([profile.level_under(x) for x in places], profile.height_at(places))
    assert [profile.edges_before(x) for x in places] == [int((profile.edge_x < x).sum()) for x in places]
    nearest = np.abs(places[:, None] - profile.edge_x).min(axis=1)
    np.testing.assert_allclose([profile.distance_to_edge(x) for x in places], nearest, atol=0)
