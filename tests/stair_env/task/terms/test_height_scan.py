import dataclasses

import numpy as np
import pytest

from stair_env.common.validation import SpecError
from stair_env.env import StairClimbEnv
from stair_env.rgbd import StairClimbRgbdEnv
from stair_env.task.terms.height_scan import GRID_X_M, GRID_Y_M, HeightScan, HeightScanConfig, height_scan_space

EXACT = HeightScanConfig(noise_m=0.0, shift_m=0.0, delay_s=0.0)


def scan(state, config=EXACT):
    return HeightScan(config)(state).reshape(len(GRID_X_M), len(GRID_Y_M))


def test_flat_ground_under_a_standing_robot_is_zero(make_state):
    state = make_state(x=-3.0)
    assert scan(state) == pytest.approx(np.zeros((17, 11)), abs=1e-6)
    assert scan(make_state(x=-3.0, above=0.30)) == pytest.approx(np.full((17, 11), 0.08), abs=1e-6)


def test_stairs_ahead_rise_row_by_row(make_state):
    """The base is 0.35 m before the first of the 0.15 m risers, treads of 0.3 m: rows from 0.4 m ahead see them."""
    seen = scan(make_state(x=-0.35))
    middle = seen[:, 5]
    assert middle[GRID_X_M < 0.35] == pytest.approx(0.0, abs=1e-6)
    assert middle[(GRID_X_M > 0.35) & (GRID_X_M < 0.65)] == pytest.approx(0.15, abs=1e-6)
    assert middle[GRID_X_M > 0.65] == pytest.approx(0.30, abs=1e-6)
    assert np.ptp(seen, axis=1).max() < 1e-6  # the flight is wider than the grid


def test_beside_the_flight_lies_the_floor(make_state):
    seen = scan(make_state(x=-0.35, y=0.3))
    assert seen[-1, GRID_Y_M < 0.25] == pytest.approx(0.30, abs=1e-6)
    assert seen[-1, GRID_Y_M > 0.35] == pytest.approx(0.0, abs=1e-6)


def test_the_grid_turns_with_the_base(make_state):
    state = make_state(x=-0.35)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # facing left: stairs are to the right
    turned = scan(state._replace(after=state.after._replace(rotation=quarter)))
    turned = turned[np.abs(GRID_X_M) < 0.55]  # as wide as the flight
    assert turned[:, GRID_Y_M < -0.35] == pytest.approx(0.15, abs=1e-6)
    assert turned[:, GRID_Y_M > -0.25] == pytest.approx(0.0, abs=1e-6)


def test_what_is_seen_is_old(make_state):
    term = HeightScan(dataclasses.replace(EXACT, delay_s=2 / 48))
    states = [make_state(x=-3.0, above=0.38 - 0.01 * step) for step in range(6)]
    seen = [float(term(state)[0]) for state in states]
    assert seen == pytest.approx([0.0, 0.0, 0.0, 0.01, 0.02, 0.03], abs=1e-6)


def test_noise_and_shift_belong_to_the_episode(make_state):
    noisy, state = HeightScanConfig(delay_s=0.0), make_state(x=-3.0)
    other = state._replace(episode=dataclasses.replace(state.episode, seed=1))
    first, again, elsewhere = (HeightScan(noisy)(s) for s in (state, state, other))
    assert np.array_equal(first, again) and not np.array_equal(first, elsewhere)
    assert 0.015 < first.std() < 0.025
    shifted = HeightScan(dataclasses.replace(EXACT, shift_m=0.3))
    assert not np.array_equal(shifted(make_state(x=-0.35)), scan(make_state(x=-0.35)).ravel())


def test_named_sets_of_observations():
    shapes = {"stairs": {"proprio", "stair"}, "height_scan": {"proprio", "height_scan"}, "proprio": {"proprio"}}
    for name, parts in shapes.items():
        env = StairClimbEnv(observations=name)
        assert set(env.observation_space) == parts
    env = StairClimbEnv(
        observations={"height_scan": {"noise_m": 0.0, "delay_s": 0.0}, "stair": None}, actuation="joint"
    )
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation) and observation["height_scan"].shape == (187,)
    env.close()
    assert (
        "height_scan"
        in StairClimbRgbdEnv(camera={"width": 160}, observations={"height_scan": {}}).observation_space.spaces
    )


@pytest.mark.parametrize(
    ("observations", "message"),
    [("lidar", "observations='lidar'.*height_scan"), ({"height_scan": {"points": 3}}, "height_scan.*points.*noise_m")],
)
def test_wrong_names_and_fields_are_told(observations, message):
    with pytest.raises(SpecError, match=message):
        StairClimbEnv(observations=observations)


def test_named_sets_are_for_the_plain_environment():
    with pytest.raises(SpecError, match=r"observations='proprio'.*StairClimb-v0"):
        StairClimbRgbdEnv(camera={"width": 160}, observations="proprio")
    with pytest.raises(SpecError, match=r"height_scan\.delay_s"):
        HeightScanConfig(delay_s=-1.0)
    assert height_scan_space().shape == (187,)
