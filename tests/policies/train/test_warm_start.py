"""Warm starts: stances are what they say, and a fitted network takes them whatever it did before."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from policies import pretrained
from policies.make_env import CLIMB_ID
from policies.stances import STANCES, Stance, stance_actions
from policies.train.warm_start import returns_to_go, warm_start
from stair_env.observation import PROPRIO_SIZE, PROPRIO_SLICES, STAIR_FIELDS


@pytest.mark.parametrize("stance", [stance for pair in STANCES.values() for stance in pair])
def test_a_stance_is_the_same_for_left_and_right_and_within_reach(stance: Stance) -> None:
    action = stance.action()
    feet = action[:12].reshape(4, 3)
    assert feet[[0, 2]] == pytest.approx(feet[[1, 3]] * [1, -1, 1])
    assert np.abs(action).max() <= 1.0 and not Stance().action().any()


def test_a_stance_lowers_and_widens_a_standing_robot() -> None:
    heights, widths = [], []
    for stance in (Stance(), Stance(lower=0.05, widen=0.05)):
        env = gym.make(CLIMB_ID, num_steps=3)
        env.reset(seed=0, options={"x": -1.5, "yaw": 0.0})
        for _ in range(20):
            env.step(stance.action())
        state = env.unwrapped.state  # type: ignore[attr-defined]
        heights.append(state.after.position[2])
        widths.append(state.feet[1, 1] - state.feet[0, 1])
        env.close()
    assert heights[0] - heights[1] == pytest.approx(0.05, abs=0.025)
    assert widths[1] - widths[0] == pytest.approx(0.10, abs=0.05)


def seen(direction: float, front_minus_rear: float) -> dict[str, np.ndarray]:
    stair, proprio = np.zeros((1, len(STAIR_FIELDS)), np.float32), np.zeros((1, PROPRIO_SIZE), np.float32)
    stair[0, :2] = abs(direction), direction
    proprio[0, PROPRIO_SLICES["foothold_height"]] = np.array([1, 1, -1, -1]) * front_minus_rear / 2
    return {"stair": stair, "proprio": proprio}


@pytest.mark.parametrize(
    ("direction", "front_minus_rear", "descends"),
    [(1, -0.3, False), (-1, 0.3, True), (0, -0.3, True), (0, 0.3, False), (0, 0.0, False)],
)
def test_the_block_tells_the_direction_and_without_it_the_footholds(
    direction: float, front_minus_rear: float, descends: bool
) -> None:
    up, down = np.zeros(16), np.ones(16)
    assert (stance_actions(seen(direction, front_minus_rear), up, down) == descends).all()


def test_returns_are_those_of_a_loop_and_unknown_without_an_end() -> None:
    rewards, dones = np.array([[1.0], [2.0], [3.0], [4.0]]), np.array([[False], [True], [False], [False]])
    returns = returns_to_go(rewards, dones, 0.5)
    assert returns[:2, 0] == pytest.approx([2.0, 2.0]) and np.isnan(returns[2:]).all()


@pytest.mark.slow
def test_the_network_takes_the_stance_whatever_it_did_before(tmp_path: Path) -> None:
    stances = Stance(lower=0.03, frequency=0.1), Stance(widen=0.03, pitch=0.1)
    folder = warm_start(tmp_path, "aliengo", {"direction": "both"}, stances=stances, steps=60, epochs=120)
    policy = pretrained.load(folder)
    for direction, stance in zip(("up", "down"), stances):
        env = gym.make(CLIMB_ID, direction=direction)
        observation, _ = env.reset(seed=3)
        for before in (np.zeros(16, np.float32), stances[0].action(), stances[1].action()):
            observation["proprio"][PROPRIO_SLICES["last_action"]] = before
            action, _ = policy.predict(observation)
            assert action == pytest.approx(stance.action(), abs=0.25)
        env.close()
    with pytest.raises(ValueError, match="stances"):
        warm_start(tmp_path, "laikago", {})
