import dataclasses
import itertools

import numpy as np
import pytest

from stair_env.env import StairClimbEnv
from stair_env.physics.simulation import FootContacts
from stair_env.task.rewards import REWARD_TERMS, read_rewards
from stair_env.task.step_state import Command
from stair_env.task.terms.legged_rewards import OPTIONAL_REWARDS, SWING_S

DT = 1 / 48


def moving(state, velocity, yaw=0.0, turn=0.0):
    cos, sin = np.cos(yaw), np.sin(yaw)
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    spin = np.array([0.0, 0.0, turn])
    return state._replace(
        after=state.after._replace(velocity=np.array(velocity), rotation=rotation, angular_velocity=spin)
    )


def value(name, *states):
    term = read_rewards({name: 1.0}).terms[name].fn
    return [term(state) for state in states]


def test_optional_terms_are_off_until_weighed(make_state):
    assert set(read_rewards().weighted(make_state())) == set(REWARD_TERMS)
    weighed = read_rewards(dict.fromkeys(OPTIONAL_REWARDS, 0.5)).weighted(make_state())
    assert set(weighed) == {*REWARD_TERMS, *OPTIONAL_REWARDS}
    assert all(isinstance(term, float) and np.isfinite(term) for term in weighed.values())


def test_tracking_is_best_at_the_command_whatever_the_heading(make_state):
    state = make_state(command=Command(0.4, 0.0, 0.2))
    exact = [moving(state, (0.4, 0.0, 0.3), turn=0.2), moving(state, (0.0, 0.4, 0.0), yaw=np.pi / 2, turn=0.2)]
    assert value("track_velocity", *exact) == pytest.approx([1.0, 1.0])
    assert value("track_turn", *exact) == pytest.approx([1.0, 1.0])
    worse = value("track_velocity", moving(state, (0.2, 0.0, 0.0)), moving(state, (-0.4, 0.0, 0.0)))
    assert 1.0 > worse[0] > worse[1] > 0.0


def test_effort_costs_by_torque_and_power(make_state):
    """Twelve joints at -2 N·m and 1 rad/s."""
    assert value("torque", make_state()) == [-48.0] and value("power", make_state()) == [-24.0]


def test_only_feet_that_stand_can_slip(make_state):
    state = make_state()
    slid = state._replace(feet=state.previous_feet + np.array([0.01, 0.0, 0.05]))
    assert value("foot_slip", slid) == pytest.approx([-4 * (0.01 / DT) ** 2])
    aloft = slid.contacts._replace(touching=np.array([True, False, False, False]))
    assert value("foot_slip", slid._replace(contacts=aloft)) == pytest.approx([-((0.01 / DT) ** 2)])


def test_air_time_counts_at_touch_down(make_state):
    state, steps = make_state(), round(0.3 / DT)
    lifted = FootContacts(np.array([False, True, True, True]), np.zeros((4, 3)), False)
    flight = [state._replace(contacts=lifted)] * steps
    found = value("air_time", *flight, state, state)
    assert found[:-2] == [0.0] * steps and found[-2] == pytest.approx(steps * DT - SWING_S) and found[-1] == 0.0


def test_terms_that_look_back_begin_anew_with_an_episode(make_state):
    state = make_state(joint_velocities=np.zeros(12))
    faster = state._replace(joint_velocities=np.full(12, 0.5))
    fresh = faster._replace(episode=dataclasses.replace(state.episode, seed=1))
    assert value("joint_acceleration", state, faster, fresh) == pytest.approx([0.0, -12 * (0.5 / DT) ** 2, 0.0])


def test_smoothness_is_zero_on_a_straight_line(make_state):
    actions = [np.full(16, level) for level in (0.0, 0.1, 0.2, 0.3, 0.3)]
    states = [make_state(action=b, previous_action=a) for a, b in itertools.pairwise(actions)]
    assert value("smoothness", *states)[1:] == pytest.approx([0.0, 0.0, -16 * 0.01])


def test_posture_and_collisions_cost(make_state):
    state = make_state()
    joints = np.tile([0.1, 1.0, -1.0], 4)
    assert value("hip_spread", state._replace(joint_positions=joints)) == pytest.approx([-0.04])
    assert value("collision", state, state._replace(contacts=state.contacts._replace(body_touches=True))) == [0.0, -1.0]
    rolling = state._replace(after=state.after._replace(angular_velocity=np.array([0.3, -0.4, 5.0])))
    assert value("trunk_rate", rolling) == pytest.approx([-0.25])


def test_each_environment_has_terms_of_its_own():
    first, second = (StairClimbEnv(rewards={"air_time": 1.0}).rewards.terms["air_time"].fn for _ in range(2))
    assert first is not second
