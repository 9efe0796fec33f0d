import dataclasses
import itertools

import numpy as np
import pytest

from stair_env.env import StairClimbEnv
from stair_env.task.step_state import StepState, riser_hits


def arrays_of(value):
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from arrays_of(part)


@pytest.fixture(scope="module")
def walked():
    env = StairClimbEnv(randomization=True)
    env.reset(seed=3)
    states = [env.state]
    for _ in range(30):
        _, _, _, _, info = env.step(np.full(16, 0.1))
        states.append(env.state)
    env.close()
    return states, info


def test_fields_are_frozen_and_arrays_read_only(walked):
    for state in (walked[0][0], walked[0][-1]):
        with pytest.raises(AttributeError):
            state.time_s = 0.0
        with pytest.raises(dataclasses.FrozenInstanceError):
            state.episode.start_x = 0.0
        found = [array for value in state for array in arrays_of(value)]
        assert len(found) == 18 and not any(array.flags.writeable for array in found)
        with pytest.raises(ValueError, match="read-only"):
            state.feet[0, 0] = 1.0


def test_every_field_is_documented():
    assert all(name in StepState.__doc__ for name in StepState._fields)


def test_steps_follow_each_other(walked):
    states, info = walked
    assert [state.time_s for state in states] == pytest.approx(np.arange(31) / 48)
    for earlier, later in itertools.pairwise(states):
        assert later.before is earlier.after and later.previous_feet is earlier.feet
        assert later.previous_action is earlier.action
    assert states[0].before is states[0].after and not states[0].action.any()
    assert states[-1].after.position.tolist() == info["truth"]["position"].tolist()
    assert sum(state.joint_power_w * state.dt_s for state in states[1:]) == pytest.approx(info["truth"]["energy_j"])


def test_geometry_is_that_of_the_profile(make_state):
    rng = np.random.default_rng(0)
    for x in rng.uniform(-1, 2, 50):
        state = make_state(x=x, feet=np.column_stack([x + rng.uniform(-0.4, 0.4, 4), np.zeros((4, 2))]))
        profile, places = state.episode.profile, state.feet[:, 0]
        assert state.ground_under_feet == pytest.approx(profile.height_at(places), abs=0)
        assert state.ground_under_base == profile.height_at(x)
        nearest = np.abs(places[:, None] - profile.edge_x).min(axis=1)
        assert state.edge_distances == pytest.approx(nearest, abs=0)


def test_slope_is_that_of_the_ground(make_state):
    assert make_state(x=-0.6).slope_rad == 0.0
    front, rear = make_state().episode.robot.hip_x
    assert np.tan(make_state(x=0.0).slope_rad) == pytest.approx(0.15 / (front - rear))


def test_steps_are_counted_once(make_state):
    assert make_state(x=0.1, travel=0.2).new_steps == 1 and make_state(x=0.1, travel=0.2).steps_climbed == 1
    assert make_state(x=-0.1, travel=-0.2).new_steps == 0 and make_state(x=-0.1, travel=-0.2).steps_climbed == 1


def test_foot_velocities_and_power(make_state):
    state = make_state(feet=make_state().feet + np.array([0.01, 0.0, 0.0]))
    assert state.foot_velocities == pytest.approx(np.tile([0.48, 0.0, 0.0], (4, 1)))
    assert state.joint_power_w == pytest.approx(24.0)  # braking counts as work


def test_riser_hits_need_force_and_direction(make_state):
    assert not any(riser_hits(make_state(force=(10.0, 0.0, 50.0)).contacts))
    assert all(riser_hits(make_state(force=(50.0, 0.0, 5.0)).contacts))
    assert not any(riser_hits(make_state(force=(4.0, 0.0, 0.0)).contacts))
    assert make_state(force=(50.0, 0.0, 5.0)).riser_hits == 4
