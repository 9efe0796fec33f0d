"""rl_zoo3's evaluation judges on the real task, whatever curriculum the training has."""

from __future__ import annotations

import gymnasium as gym
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

import stair_env  # noqa: F401
from policies.zoo import FullHeightEvaluation


def make_venv() -> DummyVecEnv:
    arguments = {"curriculum": True, "max_episode_steps": 4}
    return DummyVecEnv([lambda: Monitor(gym.make("stair_env/StairClimb-v0", **arguments))])


def test_evaluations_climb_the_whole_range_and_the_training_its_level() -> None:
    training, judging = make_venv(), make_venv()
    risers: list[float] = []

    def note(values: dict, _: dict) -> None:
        risers.append(values["info"]["truth"]["riser_height"])

    callback = EvalCallback(judging, n_eval_episodes=2, eval_freq=8, verbose=0)
    callback._log_success_callback = note  # type: ignore[method-assign]
    model = PPO("MultiInputPolicy", training, n_steps=8, batch_size=8, n_epochs=1, seed=0, device="cpu")
    model.learn(8, callback=[FullHeightEvaluation(), callback])
    assert risers and min(risers) >= 0.10
    assert training.get_attr("curriculum")[0] is not None and training.reset_infos[0]["truth"]["riser_height"] < 0.05
    training.close()
    judging.close()
