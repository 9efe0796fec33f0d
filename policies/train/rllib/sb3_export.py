"""A policy that RLlib trained as Stable-Baselines3 saves one, so that everything that reads those reads it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from policies.make_env import normalise
from policies.train import checkpoints
from policies.train.rllib import translation
from policies.train.rllib.run_state import Moments, RunState
from policies.train.training import DEFAULT_GAMMA, RLLIB_KEY, TrainingConfig, build_model

State = Mapping[str, Any]  # of a module: name -> array


class OnlySpaces(gym.Env[Any, Any]):
    """An environment that says what policies act on, and no more."""

    def __init__(self, observation_space: gym.Space, action_space: gym.Space) -> None:
        self.observation_space, self.action_space = observation_space, action_space


def save_policy(
    folder: Path, config: TrainingConfig, module: State, run: RunState, spaces: tuple[gym.Space, gym.Space], steps: int
) -> None:
    """Write `model.zip` and, where there are statistics, `vecnormalize.pkl`.

    Args:
        folder: that gets them.
        config: of the run.
        module: the module's state, arrays by name.
        run: the run's sums.
        spaces: of observations and actions.
        steps: environment steps so far.
    """
    from stable_baselines3.common.vec_env import DummyVecEnv

    hyperparams = {**config.resolved_hyperparams(), "n_envs": 1}
    hyperparams.pop(RLLIB_KEY, None)
    hyperparams["policy"] = f"policies.features.{translation.POLICIES[config.algorithm]}"
    hyperparams["policy_kwargs"] = translation.network(config.algorithm, hyperparams)
    if config.algorithm == "sac":
        hyperparams["buffer_size"] = 1
    venv: Any = DummyVecEnv([lambda: OnlySpaces(*spaces)])
    if hyperparams.get("normalize"):
        options = hyperparams["normalize"] if isinstance(hyperparams["normalize"], dict) else {}
        venv = normalise(venv, gamma=float(hyperparams.get("gamma", DEFAULT_GAMMA)), options=options)
        for key, moments in run.observations.items():
            _set(venv.obs_rms[key], moments)
        _set(venv.ret_rms, run.returns)
    model = build_model(config, hyperparams, venv)
    names = sb3_names(config.algorithm, module)
    import torch

    state = {name: torch.as_tensor(np.array(module[ours])) for ours, name in names.items()}
    model.policy.load_state_dict(state, strict=True)
    model.num_timesteps = steps
    checkpoints.save_policy(model, folder)


def sb3_names(algorithm: str, names: State) -> dict[str, str]:
    """Names of a module's parameters -> names of the same in SB3's policy; statistics are left out."""
    found = {}
    for name in names:
        start, _, rest = name.partition(".")
        if start == "normaliser":
            continue
        found[name] = rest if algorithm == "ppo" else _sac_name(start, rest, names)
    return found


def _sac_name(start: str, rest: str, names: State) -> str:
    """A parameter of `StairSacModule` by SB3's name, in which a critic's last layer has a number like the others."""
    if start == "pi":
        return f"actor.{rest}"
    if start == "pi_encoder":
        return f"actor.latent_pi.{rest.removeprefix('layers.')}"
    critic = "critic_target" if start.startswith("target_") else "critic"
    index = int("twin" in start)
    if start.endswith("_encoder"):
        return f"{critic}.qf{index}.{rest.removeprefix('layers.')}"
    hidden = [int(name.split(".")[2]) for name in names if name.startswith(f"{start}_encoder.layers.")]
    return f"{critic}.qf{index}.{max(hidden) + 2}.{rest}"


def _set(target: Any, moments: Moments) -> None:
    """Fill SB3's RunningMeanStd."""
    target.mean, target.var, target.count = np.array(moments.mean), np.array(moments.var), moments.count
