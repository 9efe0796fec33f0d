from dataclasses import fields

import numpy as np
import pytest

from stair_env.common.validation import SpecError
from stair_env.task.rewards import REWARD_TERMS, WANTED_SPEED, RewardTerm, RewardWeights, read_rewards

STEP_M = WANTED_SPEED / 48


@pytest.fixture
def terms(make_state):
    return lambda rewards=None, **changes: read_rewards(rewards).weighted(make_state(**changes))


def test_every_weight_has_its_term_and_a_good_step_earns_one(terms):
    found = terms(travel=STEP_M)
    assert tuple(found) == REWARD_TERMS == tuple(field.name for field in fields(RewardWeights))
    assert sum(found.values()) == pytest.approx(1.0)


def test_going_faster_than_wanted_earns_nothing_more(terms):
    assert terms(travel=0.1)["progress"] == pytest.approx(terms(travel=STEP_M)["progress"])
    assert terms(travel=-0.1)["progress"] == pytest.approx(-1.0)


def test_zero_weight_keeps_a_term_at_zero_and_none_takes_it_out(make_state):
    state = make_state(x=0.1, travel=0.2)
    assert read_rewards(None, {"step_bonus": 0.0}).weighted(state)["step_bonus"] == 0.0
    assert read_rewards({"step_bonus": 3}).weighted(state)["step_bonus"] == 3.0
    assert "step_bonus" not in read_rewards({"step_bonus": None}).weighted(state)


def test_upright_means_along_the_slope(terms, make_state):
    slope = make_state(x=0.0).slope_rad
    assert terms(x=0.0, tilt=-0.8 * slope)["upright"] == pytest.approx(0.0, abs=1e-12)
    assert terms(x=0.0)["upright"] < -0.05


def test_actions_cost_by_size_and_by_change(terms):
    found = terms(action=np.full(16, 0.5))
    assert found["action_size"] == pytest.approx(-0.01 * 4) and found["action_rate"] == pytest.approx(-0.02 * 4)


def test_riser_hits_and_feet_near_a_nosing_cost_by_the_foot(terms):
    assert terms(force=(50.0, 0.0, 5.0))["riser_hit"] == pytest.approx(-0.4)
    feet = [[0.29, 0.0, 0.0], [0.35, 0.0, 0.0], [-0.3, 0.0, 0.0], [-0.8, 0.0, 0.0]]
    assert terms(feet=feet)["nosing"] == pytest.approx(-0.05)


def test_endings(terms):
    assert terms(termination="success")["success"] == 10.0 and terms(termination="success")["fall"] == 0.0
    assert terms(termination="left_flight")["fall"] == -10.0
    assert terms(termination="bored")["fall"] == 0.0


def test_own_terms_come_last_or_take_a_default_ones_place(terms):
    rewards = {"power": RewardTerm(lambda state: -state.joint_power_w, 0.5), "progress": RewardTerm(lambda state: 7)}
    found = terms(rewards)
    assert list(found) == [*REWARD_TERMS, "power"]
    assert found["power"] == pytest.approx(-12.0) and found["progress"] == 7.0


def test_each_reader_gets_a_copy(make_state):
    class Counter:
        calls = 0

        def __call__(self, state):
            self.calls += 1
            return self.calls

    counter = Counter()
    first, second = (read_rewards({"count": RewardTerm(counter)}) for _ in range(2))
    assert [first.weighted(make_state())["count"] for _ in range(2)] == [1.0, 2.0]
    assert second.weighted(make_state())["count"] == 1.0 and counter.calls == 0


@pytest.mark.parametrize(
    ("rewards", "message"),
    [
        ({"joy": None}, "rewards.*joy.*progress"),
        ({"joy": 1.0}, "rewards.*joy.*progress"),
        ({"joy": "much"}, "joy.*much.*RewardTerm"),
        ({"progress": float("nan")}, "progress.*nan"),
        ({"progress": True}, "progress.*True"),
        ([RewardTerm(len)], "mapping"),
    ],
)
def test_wrong_rewards_are_named(rewards, message):
    with pytest.raises(SpecError, match=message):
        read_rewards(rewards)


def test_wrong_terms_are_named(make_state):
    with pytest.raises(SpecError, match="fn=3"):
        RewardTerm(3)
    with pytest.raises(SpecError, match="weight=inf"):
        RewardTerm(len, float("inf"))
    for wrong in (None, float("nan"), np.zeros(2)):
        with pytest.raises(SpecError, match="rewards\\['joy'\\] returned"):
            read_rewards({"joy": RewardTerm(lambda state, wrong=wrong: wrong)}).weighted(make_state())
