import math

import numpy as np
import pytest

from stair_env.common.validation import SpecError
from stair_env.task.step_state import FAILURES
from stair_env.task.termination import FALL_COSINE, WALKED_AWAY_M, read_terminations


@pytest.fixture
def verdict(make_state):
    return lambda x, terminations=None, **changes: read_terminations(terminations).reason(make_state(x=x, **changes))


@pytest.fixture
def episode(make_state):
    return make_state().episode


def test_a_robot_under_way_goes_on(verdict, episode):
    last_edge = float(episode.profile.edge_x[-1])
    assert {verdict(float(x)) for x in np.linspace(episode.start_x, last_edge, 40)} == {""}


def test_success_is_both_rear_feet_on_the_landing_and_upright(verdict, episode, make_state):
    last_edge = float(episode.profile.edge_x[-1])
    assert verdict(last_edge + 0.3) == "success"
    assert verdict(last_edge + 0.2) == ""
    assert verdict(last_edge + 0.3, tilt=0.8) == ""
    feet = np.array(make_state(x=last_edge + 0.3).feet)
    feet[2, 2] -= 0.3
    assert verdict(last_edge + 0.3, feet=feet) == ""


@pytest.mark.parametrize(
    ("reason", "changes"),
    [
        ("fall", {"tilt": math.acos(FALL_COSINE) + 0.01}),
        ("fall", {"above": 0.3 * 0.38}),
        ("fall", {"above": math.nan}),
        ("left_flight", {"y": 0.61}),
    ],
)
def test_failures_are_named(verdict, reason, changes):
    assert verdict(0.4, **changes) == reason and reason in FAILURES


def test_walking_back_is_a_failure_and_beside_the_stairs_is_none_before_them(verdict, episode):
    assert verdict(episode.start_x - WALKED_AWAY_M - 0.01) == "walked_away"
    assert verdict(episode.start_x, y=2.0) == ""


def test_own_terminations_come_last_and_none_switches_off(verdict):
    late = {"late": lambda state: state.time_s > 0.0}
    assert verdict(-0.5, late) == "late"
    assert verdict(0.4, late, y=2.0) == "left_flight"
    assert verdict(0.4, {"left_flight": None}, y=2.0) == ""
    assert verdict(0.4, {"left_flight": lambda state: False}, y=2.0) == ""


@pytest.mark.parametrize(
    ("terminations", "message"),
    [
        ({"bored": None}, "terminations.*bored.*fall"),
        ({"bored": 3}, "bored.*3.*function"),
        ({"": len}, "function"),
        ("bored", "mapping"),
    ],
)
def test_wrong_terminations_are_named(terminations, message):
    with pytest.raises(SpecError, match=message):
        read_terminations(terminations)


def test_a_forgotten_return_is_told(verdict):
    with pytest.raises(SpecError, match="terminations\\['bored'\\] returned None"):
        verdict(-0.5, {"bored": lambda state: None})
