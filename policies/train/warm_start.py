"""A policy to begin learning from: it modulates the gait by one constant action upstairs and another downstairs.

Where the gait ends, a wider and lower stance alone helps a lot (docs/climbing.md). PPO finds that slowly, by noise of a
few millimetres; trying a few constant actions finds it in minutes, and a network that has been fitted to them is where
PPO goes on. Importing this module loads SB3.

`python -m policies.train.warm_start WARM --robot aliengo` writes what `stair-env train --start-from WARM` reads.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from policies.hyperparams import load_hyperparams
from policies.make_env import CLIMB_ID, make_vec_env, normalise
from policies.stances import STANCES, Stance, stance_actions
from policies.train.checkpoints import save_policy
from policies.train.training import CARD_FILE, TrainingConfig, build_model
from stair_env.common.files import provenance, write_json
from stair_env.observation import PROPRIO_SLICES
from stair_env.onboard.gait import ACTION_SIZE

if TYPE_CHECKING:
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.vec_env import VecNormalize

NOISE = 0.06  # of the actions while flights are collected: what PPO explores with
BATCH = 512
LEARNING_RATE = 1e-3


@dataclass(frozen=True)
class Flights:
    """What was collected: rows of all environments.

    Attributes:
        observation: by key (n, ...), not normalised.
        action: (n, 16) that a stance takes there.
        value: (n,) discounted sum of the rewards up to the episode's end, NaN where the end was not reached.
    """

    observation: dict[str, np.ndarray]
    action: np.ndarray
    value: np.ndarray


def collect(venv: VecNormalize, stances: tuple[Stance, Stance], steps: int, rng: np.random.Generator) -> Flights:
    """Fly with constant actions and a little noise; the statistics of `venv` are learned on the way.

    Args:
        venv: environments.
        stances: up and down.
        steps: of each environment.
        rng: draws the noise.
    """
    up, down = (stance.action() for stance in stances)
    venv.reset()
    seen: list[dict[str, np.ndarray]] = []
    actions, rewards, dones = [], [], []
    for _ in range(steps):
        observation = {key: np.array(value) for key, value in venv.get_original_obs().items()}  # type: ignore[union-attr]
        action = stance_actions(observation, up, down)
        seen.append(observation)
        actions.append(action)
        noisy = np.clip(action + NOISE * rng.standard_normal(action.shape), -1.0, 1.0)
        _, _, done, _ = venv.step(noisy.astype(np.float32))
        rewards.append(venv.get_original_reward())
        dones.append(done)
    scale = float(np.sqrt(venv.ret_rms.var + venv.epsilon))
    values = returns_to_go(np.array(rewards) / scale, np.array(dones), venv.gamma)
    return Flights(
        {key: np.concatenate([row[key] for row in seen]) for key in seen[0]}, np.concatenate(actions), values.ravel()
    )


def returns_to_go(rewards: np.ndarray, dones: np.ndarray, gamma: float) -> np.ndarray:
    """Discounted sums of rewards to the end of each episode.

    Args:
        rewards, dones: (steps, environments).
        gamma: discount.

    Returns:
        (steps, environments), NaN in episodes that have no end.
    """
    values, ahead = np.full(rewards.shape, np.nan), np.full(rewards.shape[1], np.nan)
    for step in range(len(rewards) - 1, -1, -1):
        ahead = rewards[step] + gamma * np.where(dones[step], 0.0, ahead)
        values[step] = ahead
    return values


def fit(
    policy: ActorCriticPolicy,
    venv: VecNormalize,
    flights: Flights,
    epochs: int,
    rng: np.random.Generator,
    on_epoch: Callable[[float, float], None] | None = None,
) -> None:
    """Fit actor and critic to collected flights.

    The action before is part of the observation and would give the next one away: the network would learn to repeat it,
    and stand still for ever after a reset. It is replaced by one drawn from another row, or by none.

    Args:
        policy: PPO's.
        venv: normalises the observations.
        flights: from `collect`.
        epochs: passes over them.
        rng: draws batches.
        on_epoch: called with the mean squared errors of action and value.
    """
    import torch

    optimiser = torch.optim.Adam(policy.parameters(), LEARNING_RATE)
    count, last = len(flights.action), PROPRIO_SLICES["last_action"].start
    known = ~np.isnan(flights.value)
    for _ in range(epochs):
        order, errors = rng.permutation(count), []
        for rows in np.array_split(order, max(count // BATCH, 1)):
            batch = {key: values[rows].copy() for key, values in flights.observation.items()}
            others = flights.action[rng.integers(count, size=len(rows))] * rng.integers(0, 2, (len(rows), 1))
            drawn = others + NOISE * rng.standard_normal(others.shape)
            batch["proprio"][:, last : last + ACTION_SIZE] = np.clip(drawn, -1.0, 1.0)
            seen = {key: torch.as_tensor(value) for key, value in venv.normalize_obs(batch).items()}  # type: ignore[union-attr]
            mean = policy.get_distribution(seen).mode()
            value = policy.predict_values(seen).squeeze(1)
            worth, ended = torch.as_tensor(flights.value[rows], dtype=torch.float32), torch.as_tensor(known[rows])
            action_error = ((mean - torch.as_tensor(flights.action[rows])) ** 2).mean()
            value_error = ((value - worth)[ended] ** 2).mean()
            optimiser.zero_grad()
            (action_error + 0.1 * value_error).backward()
            optimiser.step()
            errors.append((float(action_error), float(value_error)))
        if on_epoch:
            on_epoch(*np.mean(errors, axis=0).tolist())


def warm_start(
    folder: Path | str,
    robot: str,
    env_kwargs: Mapping[str, Any],
    *,
    stances: tuple[Stance, Stance] | None = None,
    steps: int = 2500,
    epochs: int = 30,
    seed: int = 0,
    vec_kind: str = "dummy",
    on_epoch: Callable[[float, float], None] | None = None,
) -> Path:
    """Write a policy that takes one constant action up and another down, with PPO's critic and statistics.

    Args:
        folder: gets `model.zip`, `vecnormalize.pkl` and `card.json`.
        robot: key of STANCES, unless stances are given.
        env_kwargs: of the environments on which flights are collected; those of the training to come.
        stances: up and down.
        steps: collected of each environment.
        epochs: passes over them.
        seed: of environments, noise and network.
        vec_kind: see `policies.make_env.make_vec_env`.
        on_epoch: see `fit`.

    Raises:
        ValueError: a robot without stances.
    """
    if stances is None:
        if robot not in STANCES:
            raise ValueError(f"robot={robot!r} has no stances of its own, give some; there are {', '.join(STANCES)}")
        stances = STANCES[robot]
    import torch

    torch.set_num_threads(1)  # on busy cores two wait for each other
    rng, folder = np.random.default_rng(seed), Path(folder)
    kwargs = {**env_kwargs, "robot": robot}
    hyperparams = load_hyperparams("ppo", CLIMB_ID)
    venv = make_vec_env(CLIMB_ID, int(hyperparams["n_envs"]), kwargs, seed=seed, kind=vec_kind)
    try:
        normalised = normalise(venv, gamma=float(hyperparams["gamma"]), options=hyperparams["normalize"])
        flights = collect(normalised, stances, steps, rng)
        model = build_model(TrainingConfig(env_kwargs=kwargs, seed=seed), hyperparams, normalised)
        fit(cast("ActorCriticPolicy", model.policy), normalised, flights, epochs, rng, on_epoch)
        save_policy(model, folder)
    finally:
        venv.close()
    card = {
        "algorithm": "ppo",
        "method": "constant actions found by searching, a network fitted to them; no gradient of the reward",
        "env_id": CLIMB_ID,
        "env_kwargs": kwargs,
        "hyperparams": {"stances": [asdict(stance) for stance in stances], "epochs": epochs},
        "timesteps": len(flights.action),
        **provenance(seed),
    }
    write_json(folder / CARD_FILE, card, seed=seed)
    return folder


def _main() -> None:
    """`python -m policies.train.warm_start FOLDER --robot NAME [--env-kwargs JSON]`."""
    import argparse

    parser = argparse.ArgumentParser(prog="python -m policies.train.warm_start", description=warm_start.__doc__)
    parser.add_argument("folder")
    parser.add_argument("--robot", choices=tuple(STANCES), default="aliengo")
    parser.add_argument("--env-kwargs", type=json.loads, default={}, metavar="JSON")
    parser.add_argument("--steps", type=int, default=2500)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    warm_start(
        args.folder,
        args.robot,
        args.env_kwargs,
        steps=args.steps,
        seed=args.seed,
        on_epoch=lambda action, value: print(f"squared error: action {action:.4f}, value {value:.3f}", flush=True),
    )


if __name__ == "__main__":
    _main()
