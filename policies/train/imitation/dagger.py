"""DAgger: a joint-level policy learns from the gait on the states that the policy itself gets into.

Ross, Gordon and Bagnell, "A Reduction of Imitation Learning and Structured Prediction to No-Regret Online Learning",
AISTATS 2011. In each round environments are walked, first by the teacher, then more and more by the student; the
teacher says at every control step what it would do (`policies.joint_level.teaching`); the student, an ordinary
Stable-Baselines3 actor-critic policy, is fitted to all the advice so far. What comes out is a PPO model that `stair-env
train --start-from` goes on with.

A run's folder holds `config.json`, `rounds/` (each round's observations and advice), `curve.csv` (one row a round),
`checkpoints/` and at the end `final/`. `cpu_s` in the curve is the time of this process, without workers.
"""

from __future__ import annotations

import dataclasses
import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from policies.joint_level.teaching import TEACHER_KEY
from policies.make_env import CLIMB_ID, make_vec_env, normalise
from policies.train import checkpoints
from policies.train.imitation.lessons import drop_idle_inputs, fit, normalisation_of, read_lesson
from policies.train.imitation.run_folder import (
    CARD_FILE,
    CHECKPOINT_FOLDER,
    CONFIG_FILE,
    FINAL_FOLDER,
    Samples,
    read_curve,
    read_rounds,
    write_curve,
    write_round,
)
from stair_env.common.field_kinds import naming_fields
from stair_env.common.files import provenance, read_json_object, write_json
from stair_env.onboard.memory import STAIR_KEY

if TYPE_CHECKING:
    from stable_baselines3 import PPO

LOGGER = logging.getLogger(__name__)

LOG_STD_INIT = -3.0  # of the student's exploration, should PPO go on: exp(-3) = 0.05 of the action scale
NOISE_MEMORY = 0.9  # share of the teacher's noise that lasts into the next control step; white noise makes feet slip
GAMMA = 0.99


@dataclass(frozen=True)
class ImitationConfig:
    """What a run learns.

    Args:
        env_kwargs: keyword arguments of the environment, JSON-able; actuation="joint".
        teacher: one of `policies.joint_level.teaching.TEACHERS`.
        rounds: how many times to collect and fit.
        steps_per_round: control steps over all environments.
        num_envs: parallel environments.
        seed: of environments, network and drawing.
        teacher_rounds: rounds that the teacher walks.
        handover_rounds: rounds after that until the student walks alone.
        alone_share: share of the episodes that the student walks alone from then on; in the others the action is a
            mixture of both, in a proportion drawn for the episode.
        noise: standard deviation of what is added to the teacher's part of the action, so that it shows how to come
            back.
        updates: gradient steps a round; the last round makes `final_factor` times as many.
        final_factor: see `updates`.
        batch_size: samples of a gradient step.
        learning_rate: at the start of a round; it falls to a twentieth.
        symmetric: whether the policy, once learned, acts both ways (`policies.joint_level.mirror.act_both_ways`).
        net_arch: hidden layers of the actor; the critic has the same.
        episode_steps: longest episode while learning.
        vec_kind: see `policies.make_env.make_vec_env`.

    Raises:
        ValueError: a value is out of range.
    """

    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    teacher: str = "gait"
    rounds: int = 24
    steps_per_round: int = 10_240
    num_envs: int = 10
    seed: int = 0
    teacher_rounds: int = 2
    handover_rounds: int = 4
    alone_share: float = 0.6
    noise: float = 0.02
    updates: int = 2_000
    final_factor: int = 4
    batch_size: int = 256
    learning_rate: float = 1.5e-3
    symmetric: bool = True
    net_arch: tuple[int, ...] = (256, 256)
    episode_steps: int = 450
    vec_kind: str = "auto"

    @naming_fields
    def __post_init__(self) -> None:
        for name in ("rounds", "steps_per_round", "num_envs", "updates", "final_factor", "batch_size", "episode_steps"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}={getattr(self, name)!r} must be >= 1")
        if not 0.0 <= self.alone_share <= 1.0:
            raise ValueError(f"alone_share={self.alone_share!r} must lie in 0..1")


def imitate(
    config: ImitationConfig,
    folder: Path | str,
    *,
    resume: bool = False,
    on_round: Callable[[dict[str, Any]], None] | None = None,
) -> dict[str, Any]:
    """Learn from the gait.

    Args:
        config: what to learn.
        folder: the run's folder, made if missing.
        resume: go on after the last complete round in the folder.
        on_round: called with each round's row of the curve.

    Returns:
        The card of the result, as `final/card.json` holds it.

    Raises:
        ValueError: the folder holds another run and resume is False, or a wrong argument.
    """
    import torch

    folder = Path(folder)
    if (folder / CONFIG_FILE).exists() and not resume:
        raise ValueError(f"{folder} already holds a run: resume it or choose another folder")
    torch.set_num_threads(1)
    kwargs = {"memory": True, "teacher": config.teacher, "max_episode_steps": config.episode_steps, **config.env_kwargs}
    venv = make_vec_env(CLIMB_ID, config.num_envs, kwargs, seed=config.seed, kind=config.vec_kind)
    try:
        write_json(folder / CONFIG_FILE, dataclasses.asdict(config), seed=config.seed)
        saved = checkpoints.list_checkpoints(folder / CHECKPOINT_FOLDER) if resume else []
        model = _load_model(venv, saved[-1]) if saved else _new_model(config, venv)
        done = checkpoints.read_state(saved[-1])["num_timesteps"] // _steps(config) if saved else 0
        lessons = [read_lesson(model, samples) for samples in read_rounds(folder, done)]
        curve: list[dict[str, Any]] = read_curve(folder)[:done]
        for number in range(done, config.rounds):
            start, cpu_start = time.monotonic(), time.process_time()
            venv.seed(config.seed + 100_000 * number)  # resumed or not, a round walks the same episodes
            rng = np.random.default_rng([config.seed, number])
            samples, walked = collect(config, model, number, rng)
            if number == 0:
                _fix_normalisation(model, samples)
            lessons.append(read_lesson(model, samples))
            updates = config.updates * (config.final_factor if number == config.rounds - 1 else 1)
            loss = fit(model, lessons, updates, config, rng)
            if number == config.rounds - 1:
                drop_idle_inputs(model, lessons)
            model.num_timesteps += _steps(config)
            row = {"round": number, "timesteps": model.num_timesteps, "loss": loss, **walked}
            row["wall_s"] = round(time.monotonic() - start + (curve[-1]["wall_s"] if curve else 0.0), 1)
            row["cpu_s"] = round(time.process_time() - cpu_start + (curve[-1].get("cpu_s", 0.0) if curve else 0.0), 1)
            row["success_rate"] = _rate(row)
            curve.append(row)
            write_round(folder, number, samples)
            write_curve(folder, curve)
            checkpoints.save_checkpoint(model, folder / CHECKPOINT_FOLDER)
            if on_round:
                on_round(row)
        return _finish(config, model, folder, curve[-1])
    finally:
        venv.close()


def load_config(folder: Path | str) -> ImitationConfig:
    """The configuration of a run's folder.

    Raises:
        FileNotFoundError: the folder holds no run.
    """
    values = read_json_object(Path(folder) / CONFIG_FILE)
    names = {item.name for item in dataclasses.fields(ImitationConfig)}
    return ImitationConfig(**{name: value for name, value in values.items() if name in names})


def collect(
    config: ImitationConfig, model: PPO, number: int, rng: np.random.Generator
) -> tuple[Samples, dict[str, Any]]:
    """Walk one round.

    Args:
        config: of the run.
        model: the student.
        number: of the round, from 0.
        rng: draws who walks, and the teacher's noise.

    Returns:
        The observations that were met with the teacher's advice, and how the episodes went: `alone_episodes` are those
        that the student walked from beginning to end, `alone_successes` how many of them arrived.
    """
    venv = normalisation_of(model)
    count, steps = config.num_envs, _steps(config) // config.num_envs
    share = np.array([_draw_share(number, config, rng) for _ in range(count)])
    noise = np.zeros((count, *(venv.action_space.shape or ())))
    venv.reset()
    raw: Any = venv.get_original_obs()
    advice = np.array([info[TEACHER_KEY] for info in venv.unwrapped.reset_infos])
    kept: dict[str, list[np.ndarray]] = {key: [] for key in (*raw, TEACHER_KEY)}
    tally = {"episodes": 0, "successes": 0, "alone_episodes": 0, "alone_successes": 0}
    for _ in range(steps):
        for key, value in (*raw.items(), (TEACHER_KEY, advice)):
            kept[key].append(value.astype(np.float32))
        fresh = np.sqrt(1.0 - NOISE_MEMORY**2) * config.noise * rng.normal(size=noise.shape)
        noise = NOISE_MEMORY * noise + fresh
        shown = advice + noise
        if share.any():
            actions = model.policy.predict(venv.normalize_obs(raw), deterministic=True)[0]
            shown += share[:, None] * (actions - shown)
        _, _, dones, infos = venv.step(np.clip(shown, -1.0, 1.0).astype(np.float32))
        raw = venv.get_original_obs()
        advice = np.array([info[TEACHER_KEY] for info in infos])
        for index in np.flatnonzero(dones):
            _count(tally, bool(infos[index]["is_success"]), alone=share[index] == 1.0)
            advice[index] = venv.unwrapped.reset_infos[index][TEACHER_KEY]
            share[index] = _draw_share(number, config, rng)
    return {key: np.concatenate(values) for key, values in kept.items()}, tally


def _draw_share(number: int, config: ImitationConfig, rng: np.random.Generator) -> float:
    """The student's share of the action in an episode, 0..1."""
    handed_over = min(max(number + 1 - config.teacher_rounds, 0) / config.handover_rounds, 1.0)
    alone, mixture = rng.random(2)
    return 1.0 if alone < config.alone_share * handed_over else float(mixture * handed_over)


def _count(tally: dict[str, int], success: bool, alone: bool) -> None:
    for name in ("", "alone_")[: 1 + alone]:
        tally[f"{name}episodes"] += 1
        tally[f"{name}successes"] += success


def _rate(row: Mapping[str, Any]) -> float:
    """Share of the flights alone that arrived; 0 where there were none."""
    return float(row["alone_successes"] / max(row["alone_episodes"], 1))


def _steps(config: ImitationConfig) -> int:
    """Control steps of a round."""
    return max(config.steps_per_round // config.num_envs, 1) * config.num_envs


def _new_model(config: ImitationConfig, venv: Any) -> PPO:
    import torch
    from stable_baselines3 import PPO

    from policies.features import StairActorCriticPolicy

    keys = [key for key in venv.observation_space.spaces if key != STAIR_KEY]  # which the policy scales by itself
    normalised = normalise(venv, gamma=GAMMA, options={"norm_obs_keys": keys})
    normalised.training = False
    return PPO(
        StairActorCriticPolicy,
        normalised,
        seed=config.seed,
        device="cpu",
        gamma=GAMMA,
        policy_kwargs={"net_arch": list(config.net_arch), "log_std_init": LOG_STD_INIT, "activation_fn": torch.nn.ReLU},
    )


def _load_model(venv: Any, checkpoint: Path) -> PPO:
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    LOGGER.info("resuming from %s", checkpoint)
    normalised = VecNormalize.load(str(checkpoint / checkpoints.NORMALISATION_FILE), venv)
    normalised.training = False
    return PPO.load(checkpoint / checkpoints.MODEL_FILE, env=normalised, device="cpu")


def _fix_normalisation(model: PPO, samples: Samples) -> None:
    """Statistics of the teacher's round, which stay: weights and what they are fitted on must not drift apart."""
    venv = normalisation_of(model)
    for key in venv.norm_obs_keys or ():
        statistics = venv.obs_rms[key]
        statistics.mean = samples[key].mean(axis=0, dtype=np.float64)
        statistics.var = samples[key].var(axis=0, dtype=np.float64) + 1e-4  # what did not vary tells nothing
        statistics.count = float(len(samples[key]))


def _finish(config: ImitationConfig, model: PPO, folder: Path, last: dict[str, Any]) -> dict[str, Any]:
    """Write `final/`: the policy and its card."""
    final = folder / FINAL_FOLDER
    checkpoints.save_policy(model, final)
    card = {
        "algorithm": "ppo",
        "method": "dagger",
        "symmetric": config.symmetric,
        "env_id": CLIMB_ID,
        "env_kwargs": {"memory": True, **config.env_kwargs},
        "hyperparams": {k: v for k, v in dataclasses.asdict(config).items() if k not in ("env_kwargs", "seed")},
        "timesteps": model.num_timesteps,
        "training": last,
        **provenance(config.seed),
    }
    write_json(final / CARD_FILE, card, seed=config.seed)
    return card
