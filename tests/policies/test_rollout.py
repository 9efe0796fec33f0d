"""Who acts without training."""

from __future__ import annotations

import gymnasium as gym
import numpy as np

from policies.make_env import CLIMB_ID, make_env
from policies.rollout import CONTROLS, RandomAction, run_episode

SPACE = gym.spaces.Box(-1.0, 1.0, (16,), np.float32)


def act(first: float, steps: int = 3) -> np.ndarray:
    policy, state, actions = RandomAction(SPACE), None, []
    for step in range(steps):
        action, state = policy.predict({"proprio": np.full(3, first + step)}, state)
        assert SPACE.contains(action)
        actions.append(action)
    return np.array(actions)


def test_random_actions_belong_to_the_episode() -> None:
    assert np.array_equal(act(0.5), act(0.5))
    assert not np.array_equal(act(0.5), act(0.6))
    assert np.ptp(act(0.5), axis=0).min() > 0.0


def test_zero_leaves_the_gait_to_itself() -> None:
    action, _ = CONTROLS["zero"](SPACE).predict({})
    assert SPACE.contains(action) and not action.any()


def test_a_policy_without_a_stair_block_measures_nothing() -> None:
    env = make_env(CLIMB_ID, {"observations": "proprio", "max_episode_steps": 3}, monitor=False)
    episode = run_episode(env, CONTROLS["zero"](env.action_space), seed=0)
    assert episode.control_steps == 3 and episode.seen == 3 and episode.measured == 0
    env.close()
