from dataclasses import fields

import numpy as np
import pytest

from stair_env.physics.simulation import BaseState, FootContacts
from stair_env.stairs import StairSpec
from stair_env.task.rewards import (
    WANTED_SPEED,
    RewardWeights,
    StepOutcome,
    feet_near_nosing,
    reward_terms,
    riser_hits,
)

PROFILE = StairSpec().profile()
FEET = [[-0.3, -0.1, 0.03], [-0.3, 0.1, 0.03], [-0.8, -0.1, 0.03], [-0.8, 0.1, 0.03]]


def contacts(force=(0.0, 0.0, 50.0)):
    return FootContacts(np.ones(4, bool), np.tile(force, (4, 1)), False)


def base(x, rotation=None):
    return BaseState(np.array([x, 0.0, 0.4]), np.eye(3) if rotation is None else rotation, np.zeros(3), np.zeros(3))


def terms(**changes):
    values = {
        "before": base(-0.5),
        "after": base(-0.5 + WANTED_SPEED / 48),
        "feet": FEET,
        "contacts": contacts(),
        "riser_hits": 0,
        "action": np.zeros(16),
        "last_action": np.zeros(16),
        "new_steps": 0,
        "slope_rad": 0.0,
        "success": False,
        "fell": False,
        "dt": 1 / 48,
    }
    return reward_terms(StepOutcome(**{**values, **changes}), PROFILE, RewardWeights())


def test_every_weight_has_its_term_and_a_good_step_earns_one():
    found = terms()
    assert set(found) == {field.name for field in fields(RewardWeights)}
    assert sum(found.values()) == pytest.approx(1.0)


def test_going_faster_than_wanted_earns_nothing_more():
    assert terms(after=base(-0.4))["progress"] == pytest.approx(terms()["progress"])
    assert terms(after=base(-0.6))["progress"] == pytest.approx(-1.0)


def test_zero_weight_switches_a_term_off():
    outcome = StepOutcome(
        base(0), base(0), FEET, contacts(), 0, np.zeros(16), np.zeros(16), 1, 0.0, True, False, 1 / 48
    )
    assert reward_terms(outcome, PROFILE, RewardWeights(step_bonus=0.0, success=0.0))["step_bonus"] == 0.0


def test_upright_means_along_the_slope():
    slope = 0.4
    nose_up = -0.8 * slope
    tilted = np.array([[np.cos(nose_up), 0, np.sin(nose_up)], [0, 1, 0], [-np.sin(nose_up), 0, np.cos(nose_up)]])
    assert terms(after=base(-0.49, tilted), slope_rad=slope)["upright"] == pytest.approx(0.0, abs=1e-12)
    assert terms(after=base(-0.49, tilted))["upright"] < -0.05


def test_riser_hits_need_force_and_direction():
    assert not any(riser_hits(contacts((10.0, 0.0, 50.0))))
    assert all(riser_hits(contacts((50.0, 0.0, 5.0))))
    assert not any(riser_hits(contacts((4.0, 0.0, 0.0))))
    assert terms(riser_hits=2)["riser_hit"] == 2 * terms(riser_hits=1)["riser_hit"] < 0.0


def test_feet_near_a_nosing_are_found():
    feet = [[0.29, 0.0, 0.0], [0.35, 0.0, 0.0], *FEET[2:]]
    assert feet_near_nosing(feet, contacts(), PROFILE) == [True, False, False, False]
