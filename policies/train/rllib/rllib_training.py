"""`stair-env train --engine rllib`: environment runners over a Ray cluster, one learner, a policy as SB3 saves it.

The run's folder holds what `policies.train.training` writes: `config.json`, `checkpoints/`, `curve.csv` and `final/`.
A checkpoint has RLlib's own state in `rllib/` for `--resume`, and beside it the policy as `evaluate --policy` reads it.
"""

from __future__ import annotations

import contextlib
import csv
import json
import logging
import os
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from policies.train import checkpoints
from policies.train.curves import CURVE_FIELDS, CURVE_FILE, read_curve
from policies.train.described import described
from policies.train.rllib import runners, sb3_export, translation
from policies.train.rllib.run_state import Moments, RunState
from policies.train.training import (
    CARD_FILE,
    CHECKPOINT_FOLDER,
    CONFIG_FILE,
    DEFAULT_GAMMA,
    FINAL_FOLDER,
    TrainingConfig,
)
from stair_env.common.files import provenance, write_json
from stair_env.common.progress import progress_bar
from stair_env.common.tasks import Engine
from stair_env.common.tasks.ray_pool import ray_session

ALGORITHM_FOLDER = "rllib"  # of a checkpoint: RLlib's own state
RUN_FILE = "run_state.json"
ENV_NAME = "stair_env"
WARM_UP_STEPS = 1024  # of an environment left to its gait, whose moments the first iteration begins with
KEPT_CHECKPOINTS = 2
# Columns of the curve, by RLlib's names.
LEARNED = {"approx_kl": "mean_kl_loss", "explained_variance": "vf_explained_var", "value_loss": "vf_loss"}
LEARNED |= {"ent_coef": "alpha_value"}


def train(
    config: TrainingConfig, folder: Path | str, *, resume: bool = False, show_progress: bool = False
) -> dict[str, Any]:
    """Train a policy with RLlib.

    Args:
        config: what to train.
        folder: the run's folder, made if missing.
        resume: go on from the newest checkpoint in the folder (from the start when there is none yet).
        show_progress: draw a progress bar on stderr.

    Returns:
        The card of the result, as `final/card.json` holds it.

    Raises:
        ValueError: the folder holds another run and resume is False, or a setting has no counterpart in RLlib.
        stair_env.common.tasks.EngineError: no cluster at the address.
    """
    folder = Path(folder)
    if (folder / CONFIG_FILE).exists() and not resume:
        raise ValueError(f"{folder} already holds a run: resume it or choose another folder")
    saved = checkpoints.list_checkpoints(folder / CHECKPOINT_FOLDER) if resume else []
    with contextlib.ExitStack() as opened:
        cores = config.workers + 1  # and one for a learner of its own, which `rllib:` may ask for
        opened.enter_context(ray_session(Engine("ray", cores, config.ray_address)))
        run = _Training(config, folder)
        opened.callback(run.algorithm.stop)
        write_json(folder / CONFIG_FILE, config.to_dict(), seed=config.seed)  # only now: wrong arguments leave no run
        run.begin(saved[-1] if saved else None)
        return run.finish(show_progress)


class _Training:
    """A run under way."""

    def __init__(self, config: TrainingConfig, folder: Path) -> None:
        from ray.tune.registry import register_env

        logging.getLogger("ray.rllib").setLevel(logging.ERROR)  # it greets with advice to its older users
        self.config, self.folder = config, folder
        self.hyperparams = config.resolved_hyperparams()
        self.total, self.steps = int(self.hyperparams["n_timesteps"]), 0
        gamma = float(self.hyperparams.get("gamma", DEFAULT_GAMMA))
        env_kwargs = _with_shared_network(config)
        maker = runners.ReportingEnv(config.env_id, env_kwargs, (), gamma, False)
        with contextlib.closing(maker()) as probe:
            space: Any = probe.observation_space
            self.spaces: tuple[gym.Space, gym.Space] = space, probe.action_space
            curriculum = getattr(probe.unwrapped, "curriculum", None)
        normalised = translation.normalisation(self.hyperparams, space)
        keys = normalised["norm_obs_keys"]
        self._maker = runners.ReportingEnv(config.env_id, env_kwargs, tuple(keys), gamma, normalised["norm_reward"])
        settings = translation.translate(
            config.algorithm, self.hyperparams, space=space, workers=config.workers, seed=config.seed
        )
        moments = {key: Moments(space[key].shape) for key in keys}
        self.run = RunState(moments, curriculum, int(self.hyperparams.get("n_envs", 1)))
        register_env(ENV_NAME, self._maker)
        settings.environment(ENV_NAME, observation_space=space, action_space=self.spaces[1])
        settings.callbacks(on_env_runners_recreated=runners.share_with_new)
        self.algorithm: Any = settings.build_algo()
        self.algorithm.stair_run = self.run
        self._curve = _Curve(folder / CURVE_FILE)

    def begin(self, checkpoint: Path | None) -> None:
        """From a checkpoint, or with the moments of the gait."""
        if checkpoint is None:
            self._warm_up()
        else:
            self.algorithm.restore_from_path(str((checkpoint / ALGORITHM_FOLDER).resolve()))
            self.run.restore(json.loads((checkpoint / RUN_FILE).read_text(encoding="utf-8")))
            self.steps = int(checkpoints.read_state(checkpoint)["num_timesteps"])
        runners.share(self.algorithm, self.run)
        self._curve.begin(self.steps)

    def _warm_up(self) -> None:
        """Statistics to begin with: without, the first update would be one of raw numbers."""
        with contextlib.closing(self._maker()) as env:
            rng = np.random.default_rng(self.config.seed)
            env.reset(seed=self.config.seed)
            space: Any = env.action_space
            for _ in range(WARM_UP_STEPS):
                action = 0.06 * rng.standard_normal(space.shape)
                _, _, terminated, truncated, _ = env.step(np.clip(action, space.low, space.high).astype(space.dtype))
                if terminated or truncated:
                    env.reset()
            met = env.collect()
        self.run.absorb([type(met)(met.observations, met.returns, [])])  # flights of the gait count for no curve

    def finish(self, show_progress: bool) -> dict[str, Any]:
        """Train to the end; write checkpoints, curve and the policy."""
        last_saved = self.steps
        with progress_bar(self.total, "train", initial=min(self.steps, self.total), unit="step") as bar:
            bar.disable = bar.disable or not show_progress
            while self.steps < self.total:
                sampled = self._iterate()
                bar.set_postfix(self._curve.shown(), refresh=False)
                bar.update(min(sampled, self.total - bar.n))
                if self.steps - last_saved >= self.config.checkpoint_every or self.steps >= self.total:
                    self.save_checkpoint()
                    last_saved = self.steps
        return self._write_final()

    def _iterate(self) -> int:
        """One iteration; returns how many steps were sampled."""
        result = self.algorithm.train()
        before, self.steps = self.steps, int(result["num_env_steps_sampled_lifetime"])
        self.run.absorb(runners.collect(self.algorithm))
        runners.share(self.algorithm, self.run)
        learned = result.get("learners", {}).get(runners.MODULE, {})
        self._curve.add(self.steps, self.run, {ours: learned.get(theirs) for ours, theirs in LEARNED.items()})
        return self.steps - before

    def save_checkpoint(self) -> Path:
        """Write `checkpoints/step_N`, whole or not at all, and drop all but the newest."""
        folder = self.folder / CHECKPOINT_FOLDER
        target = folder / f"{checkpoints.FOLDER_PREFIX}{self.steps:09d}"
        partial = folder / f".partial_{target.name}"
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        self._save_policy(partial)
        self.algorithm.save_to_path(str((partial / ALGORITHM_FOLDER).resolve()))
        (partial / RUN_FILE).write_text(json.dumps(self.run.state()), encoding="utf-8")
        curriculum = self.run.curriculum.state() if self.run.curriculum else None
        state = {"num_timesteps": self.steps, "curriculum": None if curriculum is None else [curriculum]}
        (partial / checkpoints.STATE_FILE).write_text(json.dumps(state), encoding="utf-8")
        shutil.rmtree(target, ignore_errors=True)
        os.replace(partial, target)
        for old in checkpoints.list_checkpoints(folder)[:-KEPT_CHECKPOINTS]:
            shutil.rmtree(old, ignore_errors=True)
        return target

    def _save_policy(self, folder: Path) -> None:
        state = runners.module_state(self.algorithm)
        sb3_export.save_policy(folder, self.config, state, self.run, self.spaces, self.steps)

    def _write_final(self) -> dict[str, Any]:
        final = self.folder / FINAL_FOLDER
        self._save_policy(final)
        curriculum = self.run.curriculum
        card = {
            "algorithm": self.config.algorithm,
            "engine": self.config.engine,
            "env_id": self.config.env_id,
            "env_kwargs": described(self.config.resolved_env_kwargs()),
            "hyperparams": self.hyperparams,
            "timesteps": self.steps,
            "training": self._curve.row,
            "curriculum": None if curriculum is None else [curriculum.state()],
            **provenance(self.config.seed),
        }
        write_json(final / CARD_FILE, card, seed=self.config.seed)
        return card


def _with_shared_network(config: TrainingConfig) -> dict[str, Any]:
    """Arguments of the environments; where it is wanted their cameras ask one network."""
    env_kwargs = config.resolved_env_kwargs()
    if not config.network_server:
        return env_kwargs
    from perception.inference.frame_server import start_frame_server

    return {**env_kwargs, "estimator": {**env_kwargs.get("estimator", {}), "detector": start_frame_server()}}


class _Curve:
    """`curve.csv` with a row an iteration, as `policies.train.callbacks.CurveCallback` writes it.

    Attributes:
        row: the newest.
    """

    def __init__(self, path: Path) -> None:
        self.row: dict[str, Any] = {}
        self._path, self._before, self._started = path, 0.0, time.monotonic()

    def begin(self, steps: int) -> None:
        """Cut what will be done again."""
        rows = [row for row in read_curve(self._path) if row["timesteps"] <= steps] if steps else []
        self.row = rows[-1] if rows else {}
        self._before, self._started = self.row.get("wall_s", 0.0), time.monotonic()
        with self._path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, CURVE_FIELDS)
            writer.writeheader()
            writer.writerows(rows)

    def add(self, steps: int, run: RunState, learned: Mapping[str, Any]) -> None:
        """Write a row."""
        recent = run.recent
        self.row = {
            "timesteps": steps,
            "wall_s": round(self._before + time.monotonic() - self._started, 1),
            "episodes": run.episodes,
            "return_mean": _mean([episode.total_reward for episode in recent]),
            "length_mean": _mean([episode.length for episode in recent]),
            "success_rate": _mean([episode.success for episode in recent]),
            "level_mean": "" if run.curriculum is None else run.curriculum.level,
            **{name: "" if value is None else round(float(value), 6) for name, value in learned.items()},
        }
        with self._path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, CURVE_FIELDS).writerow(self.row)

    def shown(self) -> dict[str, Any]:
        """What stands beside the progress bar."""
        return {"success": self.row["success_rate"], "level": self.row["level_mean"]}


def _mean(values: list[Any]) -> float | str:
    """Rounded mean, "" (an empty cell) of nothing."""
    return round(float(np.mean(values)), 4) if values else ""
