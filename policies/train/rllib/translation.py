"""From hyperparameters as Stable-Baselines3 and rl_zoo3 name them to RLlib's configuration."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import gymnasium as gym

from policies.make_env import NORMALISED_KEYS
from policies.train.training import DEFAULT_GAMMA, NOT_THE_ALGORITHMS, RLLIB_KEY

if TYPE_CHECKING:
    from ray.rllib.algorithms.algorithm_config import AlgorithmConfig

POLICIES = {"ppo": "StairActorCriticPolicy", "sac": "StairSacPolicy"}
DEFAULT_NET_ARCH = {"ppo": [64, 64], "sac": [256, 256]}  # of SB3
CLIP_OBS = 10.0  # of VecNormalize
KL_COEFFICIENT = 0.2  # with which RLlib begins
STEPS_PER_ITERATION = 2000  # of SAC, between two looks at curriculum and statistics
# SB3's name -> RLlib's, where the meaning is the same.
SAME = {
    "ppo": {
        "n_epochs": "num_epochs",
        "batch_size": "minibatch_size",
        "gamma": "gamma",
        "gae_lambda": "lambda_",
        "clip_range": "clip_param",
        "ent_coef": "entropy_coeff",
        "vf_coef": "vf_loss_coeff",
        "max_grad_norm": "grad_clip",
    },
    "sac": {
        "batch_size": "train_batch_size_per_learner",
        "learning_starts": "num_steps_sampled_before_learning_starts",
        "tau": "tau",
        "gamma": "gamma",
    },
}
# What SB3 takes when the file says nothing, and RLlib would take otherwise.
SB3_DEFAULTS: dict[str, dict[str, Any]] = {
    "ppo": {"n_steps": 2048, "batch_size": 64, "n_epochs": 10, "gae_lambda": 0.95, "clip_range": 0.2, "ent_coef": 0.0}
    | {"vf_coef": 0.5, "max_grad_norm": 0.5, "gamma": DEFAULT_GAMMA, "learning_rate": 3e-4, "target_kl": None},
    "sac": {"batch_size": 256, "learning_starts": 100, "tau": 0.005, "gamma": DEFAULT_GAMMA, "learning_rate": 3e-4}
    | {"buffer_size": 1_000_000, "train_freq": 1, "gradient_steps": 1, "ent_coef": "auto", "target_entropy": "auto"},
}


def normalisation(hyperparams: Mapping[str, Any], space: gym.spaces.Dict) -> dict[str, Any]:
    """The value of `normalize` in full: `norm_obs_keys`, `clip_obs` and `norm_reward`.

    Raises:
        ValueError: an option that has no counterpart here.
    """
    value = hyperparams.get("normalize", False)
    options = dict(value) if isinstance(value, Mapping) else {}
    unknown = sorted(set(options) - {"norm_obs", "norm_obs_keys", "norm_reward", "clip_obs", "gamma"})
    if unknown:
        raise ValueError(f"normalize has {', '.join(unknown)}, which the engine rllib does not know")
    keys = options.get("norm_obs_keys") or [key for key in NORMALISED_KEYS if key in space.spaces]
    return {
        "norm_obs_keys": list(keys) if value and options.get("norm_obs", True) else [],
        "clip_obs": float(options.get("clip_obs", CLIP_OBS)),
        "norm_reward": bool(value) and bool(options.get("norm_reward", True)),
    }


def network(algorithm: str, hyperparams: Mapping[str, Any]) -> dict[str, Any]:
    """`policy_kwargs`, with what SB3 takes by default.

    Raises:
        ValueError: another policy, or arguments that the modules here do not know.
    """
    policy = str(hyperparams.get("policy", POLICIES[algorithm])).rpartition(".")[2]
    if policy != POLICIES[algorithm]:
        raise ValueError(f"policy={policy!r}: with --engine rllib {algorithm} trains {POLICIES[algorithm]}")
    kwargs = {"net_arch": DEFAULT_NET_ARCH[algorithm], **dict(hyperparams.get("policy_kwargs", {}))}
    unknown = sorted(set(kwargs) - {"net_arch", "log_std_init"})
    if unknown:
        raise ValueError(f"policy_kwargs has {', '.join(unknown)}, which the engine rllib does not know")
    return kwargs


def translate(
    algorithm: str, hyperparams: Mapping[str, Any], *, space: gym.spaces.Dict, workers: int, seed: int
) -> AlgorithmConfig:
    """RLlib's configuration, but for the environment.

    Args:
        algorithm: "ppo" or "sac".
        hyperparams: as `TrainingConfig.resolved_hyperparams` gives them; what stands under `rllib` goes to RLlib as it
            is and comes last.
        space: of the observations.
        workers: environment runners.
        seed: of everything.

    Raises:
        ValueError: a hyperparameter has no counterpart.
    """
    from ray.rllib.core.rl_module.rl_module import RLModuleSpec

    from policies.train.rllib.rl_modules import StairPpoModule, StairSacModule

    given = {name: value for name, value in hyperparams.items() if name not in NOT_THE_ALGORITHMS}
    given = {name: value for name, value in given.items() if name not in ("policy", "policy_kwargs", RLLIB_KEY)}
    unknown = sorted(set(given) - set(SB3_DEFAULTS[algorithm]))
    if unknown:
        raise ValueError(
            f"{', '.join(unknown)} of {algorithm} has no counterpart in RLlib: leave it out, or put it under "
            f"{RLLIB_KEY}: by RLlib's name"
        )
    values = {**SB3_DEFAULTS[algorithm], **given}
    envs = int(hyperparams.get("n_envs", 1))
    runners = min(workers, envs)
    build: dict[str, Callable[..., AlgorithmConfig]] = {"ppo": _ppo, "sac": _sac}
    config = build[algorithm](values, envs, int(hyperparams["n_timesteps"]))
    kwargs, normalised = network(algorithm, hyperparams), normalisation(hyperparams, space)
    model = {"normalised": normalised["norm_obs_keys"], "clip_obs": normalised["clip_obs"]}
    if algorithm == "ppo":
        spec = RLModuleSpec(module_class=StairPpoModule, model_config={**model, "policy_kwargs": kwargs})
    else:
        spec = RLModuleSpec(module_class=StairSacModule, model_config={**model, "net_arch": actor_and_critic(kwargs)})
    config.rl_module(rl_module_spec=spec)
    config.framework("torch").debugging(seed=seed, log_level="ERROR")
    config.env_runners(num_env_runners=runners, num_envs_per_env_runner=math.ceil(envs / runners))
    config.fault_tolerance(restart_failed_env_runners=True)
    own = dict(hyperparams.get(RLLIB_KEY) or {})
    foreign = sorted(name for name in own if not hasattr(config, name))
    if foreign:
        raise ValueError(f"{RLLIB_KEY} has {', '.join(foreign)}, which {type(config).__name__} does not know")
    return config.update_from_dict(own)


def actor_and_critic(policy_kwargs: Mapping[str, Any]) -> dict[str, list[int]]:
    """`net_arch` of SAC, which may be one list for both networks."""
    arch = policy_kwargs["net_arch"]
    both = arch if isinstance(arch, Mapping) else {"pi": arch, "qf": arch}
    return {name: list(both[name]) for name in ("pi", "qf")}


def learning_rate(value: float | str, timesteps: int) -> Any:
    """A number, or for `lin_NUMBER` the schedule that falls to zero over the run.

    Raises:
        ValueError: neither.
    """
    if not isinstance(value, str):
        return float(value)
    kind, _, number = value.partition("_")
    if kind != "lin":
        raise ValueError(f"learning_rate={value!r} must be a number or lin_NUMBER")
    return [[0, float(number)], [timesteps, 0.0]]


def _ppo(values: Mapping[str, Any], envs: int, timesteps: int) -> AlgorithmConfig:
    from ray.rllib.algorithms.ppo import PPOConfig

    config = PPOConfig()
    # Clipped here, as SB3 does: a distribution over unbounded actions, an environment with bounded ones.
    config.environment(normalize_actions=False, clip_actions=True)
    target_kl = values["target_kl"]
    config.training(
        **{name: values[ours] for ours, name in SAME["ppo"].items()},
        lr=learning_rate(values["learning_rate"], timesteps),
        train_batch_size_per_learner=int(values["n_steps"]) * envs,
        vf_clip_param=math.inf,  # SB3 clips no value
        # Of SB3 the bound at which epochs end, of RLlib the aim of a penalty whose weight follows the divergence.
        use_kl_loss=target_kl is not None,
        kl_target=float(target_kl or 1.0),
        kl_coeff=KL_COEFFICIENT if target_kl is not None else 0.0,
        grad_clip_by="global_norm",
    )
    return config


def _sac(values: Mapping[str, Any], envs: int, timesteps: int) -> AlgorithmConfig:
    from ray.rllib.algorithms.sac import SACConfig

    entropy, rate = values["ent_coef"], learning_rate(values["learning_rate"], timesteps)
    learned = isinstance(entropy, str)
    initial = float(entropy.partition("_")[2] or 1.0) if learned else float(entropy)
    config = SACConfig()
    config.environment(normalize_actions=False, clip_actions=True)
    config.training(
        **{name: values[ours] for ours, name in SAME["sac"].items()},
        actor_lr=rate,
        critic_lr=rate,
        alpha_lr=rate if learned else 0.0,
        initial_alpha=initial,
        target_entropy=values["target_entropy"],
        replay_buffer_config={"type": "EpisodeReplayBuffer", "capacity": int(values["buffer_size"])},
        training_intensity=values["gradient_steps"] * values["batch_size"] / (values["train_freq"] * envs),
        target_network_update_freq=1,
        n_step=1,
    )
    config.env_runners(rollout_fragment_length=int(values["train_freq"]))
    config.reporting(min_sample_timesteps_per_iteration=STEPS_PER_ITERATION, min_time_s_per_iteration=None)
    return config
