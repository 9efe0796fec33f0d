"""What happens beside the learning: checkpoints, a learning curve, a progress bar. Importing this loads SB3."""

from __future__ import annotations

import csv
import time
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from policies.train.checkpoints import save_checkpoint
from policies.train.curves import CURVE_FIELDS, LOGGED, read_curve
from stair_env.common.progress import progress_bar

LEVEL_KEY = "curriculum_level"
CURVE_EVERY = 4096  # environment steps: one row for each PPO rollout of 8 x 512


class CheckpointCallback(BaseCallback):
    """Writes a checkpoint between rollouts, so that none cuts a rollout in two."""

    def __init__(self, folder: Path, every: int, keep: int = 2) -> None:
        super().__init__()
        self._folder, self._every, self._keep = folder, every, keep
        self._last = 0

    def _on_training_start(self) -> None:
        self._last = self.model.num_timesteps

    def _on_rollout_start(self) -> None:
        if self.model.num_timesteps - self._last >= self._every:
            self._save()

    def _on_training_end(self) -> None:
        self._save()

    def _save(self) -> None:
        self._last = self.model.num_timesteps
        save_checkpoint(self.model, self._folder, keep=self._keep)

    def _on_step(self) -> bool:
        return True


class CurveCallback(BaseCallback):
    """Appends a row to a CSV file every CURVE_EVERY environment steps; a resumed run cuts what it will do again.

    Return, length and success are means over the last 100 episodes. `level_mean` is the mean curriculum level of the
    environments, from `info["curriculum_level"]`, empty where there is none.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        self._last_row = 0
        self._episodes = 0
        self._wall_before = 0.0
        self._started = 0.0
        self._levels: dict[int, float] = {}
        self._row: dict[str, Any] = {}

    def summary(self) -> dict[str, Any]:
        """The newest row."""
        return dict(self._row)

    def _on_training_start(self) -> None:
        rows = read_curve(self._path) if self.model.num_timesteps else []
        rows = [row for row in rows if row["timesteps"] <= self.model.num_timesteps]
        self._row = rows[-1] if rows else {}
        self._wall_before = self._row.get("wall_s", 0.0)
        self._episodes = int(self._row.get("episodes", 0))
        self._last_row = self.model.num_timesteps
        self._started = time.monotonic()
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, CURVE_FIELDS)
            writer.writeheader()
            writer.writerows(rows)

    def _on_step(self) -> bool:
        self._episodes += int(np.sum(self.locals["dones"]))
        for index, info in enumerate(self.locals["infos"]):
            if LEVEL_KEY in info:
                self._levels[index] = float(info[LEVEL_KEY])
        return True

    def _on_rollout_start(self) -> None:
        if self.model.num_timesteps - self._last_row >= CURVE_EVERY:
            self._write()

    def _on_training_end(self) -> None:
        self._write()

    def _write(self) -> None:
        self._last_row = self.model.num_timesteps
        buffer, successes = self.model.ep_info_buffer or (), self.model.ep_success_buffer or ()
        logged = self.model.logger.name_to_value
        self._row = {
            "timesteps": self.model.num_timesteps,
            "wall_s": round(self._wall_before + time.monotonic() - self._started, 1),
            "episodes": self._episodes,
            "return_mean": _mean([episode["r"] for episode in buffer]),
            "length_mean": _mean([episode["l"] for episode in buffer]),
            "success_rate": _mean(list(successes)),
            "level_mean": _mean(list(self._levels.values())),
            **{name: _number(logged.get(f"train/{name}")) for name in LOGGED},
        }
        with self._path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, CURVE_FIELDS).writerow(self._row)


class ProgressCallback(BaseCallback):
    """A progress bar over the whole run with success rate and curriculum level."""

    def __init__(self, total: int) -> None:
        super().__init__()
        self._total = total
        self._bar: Any = None
        self._levels: dict[int, float] = {}

    def _on_training_start(self) -> None:
        self._bar = progress_bar(self._total, "train", initial=self.model.num_timesteps, unit="step")

    def _on_step(self) -> bool:
        self._bar.update(self.model.num_timesteps - self._bar.n)
        self._levels.update((i, info[LEVEL_KEY]) for i, info in enumerate(self.locals["infos"]) if LEVEL_KEY in info)
        return True

    def _on_rollout_end(self) -> None:
        shown = {
            "success": _mean(list(self.model.ep_success_buffer or ())),
            "level": _mean(list(self._levels.values())),
        }
        self._bar.set_postfix({name: f"{value:.2f}" for name, value in shown.items() if value != ""}, refresh=False)

    def _on_training_end(self) -> None:
        self._bar.close()


def _mean(values: list[float]) -> float | str:
    """Rounded mean, "" (an empty cell) of nothing."""
    return round(float(np.mean(values)), 4) if values else ""


def _number(value: Any) -> float | str:
    """Rounded number, "" (an empty cell) for None."""
    return "" if value is None else round(float(value), 6)
