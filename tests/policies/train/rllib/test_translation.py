"""One YAML file for both engines: what translates, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from policies.hyperparams import load_hyperparams
from policies.make_env import CLIMB_ID
from policies.train.rllib import translation
from stair_env.observation import stair_space

pytest.importorskip("ray", reason="Ray is not installed: pip install 'stair-env[ray]', or make test-ray")

SPACE = gym.spaces.Dict({"proprio": gym.spaces.Box(-1, 1, (3,), np.float32), "stair": stair_space()})


def translated(algorithm: str, **changes: Any) -> Any:
    hyperparams = {**load_hyperparams(algorithm, CLIMB_ID), **changes}
    return translation.translate(algorithm, hyperparams, space=SPACE, workers=4, seed=1)


def test_the_shipped_ppo_file_translates() -> None:
    config = translated("ppo")
    assert config.train_batch_size_per_learner == 8 * 1024 and config.minibatch_size == 2048
    assert (config.num_epochs, config.lr, config.gamma, config.lambda_) == (6, 1e-4, 0.99, 0.95)
    assert (config.clip_param, config.vf_clip_param, config.entropy_coeff) == (0.2, math.inf, 0.0)
    assert config.use_kl_loss and config.kl_target == 0.06
    assert (config.num_env_runners, config.num_envs_per_env_runner) == (4, 2)
    model = config.rl_module_spec.model_config
    assert model["policy_kwargs"] == {"net_arch": [256, 128], "log_std_init": -2.8} and model["normalised"] == [
        "proprio"
    ]
    assert not translated("ppo", target_kl=None).use_kl_loss


def test_the_shipped_sac_file_translates() -> None:
    config = translated("sac")
    assert config.training_intensity == 8 * 256 / (8 * 8)
    assert (config.tau, config.gamma, config.initial_alpha, config.target_entropy) == (0.01, 0.98, 0.02, -16.0)
    assert config.replay_buffer_config["capacity"] == 500_000 and config.train_batch_size_per_learner == 256
    assert config.rl_module_spec.model_config["net_arch"] == {"pi": [256, 128], "qf": [256, 128]}
    fixed = translated("sac", ent_coef=0.1)
    assert (fixed.initial_alpha, fixed.alpha_lr) == (0.1, 0.0)


def test_rllibs_own_settings_come_last() -> None:
    config = translated("ppo", rllib={"num_env_runners": 7, "minibatch_size": 512})
    assert config.num_env_runners == 7 and config.minibatch_size == 512


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"use_sde": True}, "use_sde of ppo has no counterpart"),
        ({"rllib": {"num_env_runner": 7}}, "num_env_runner, which PPOConfig does not know"),
        ({"policy": "MultiInputPolicy"}, "policy='MultiInputPolicy'"),
        ({"policy_kwargs": {"ortho_init": False}}, "ortho_init"),
        ({"normalize": {"epsilon": 1.0}}, "normalize has epsilon"),
        ({"learning_rate": "cos_1"}, "cos_1"),
    ],
)
def test_what_has_no_counterpart_is_named(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        translated("ppo", **changes)


def test_a_rate_may_fall() -> None:
    assert translation.learning_rate("lin_3e-4", 1000) == [[0, 3e-4], [1000, 0.0]]
    assert translation.learning_rate(1e-3, 1000) == 1e-3
