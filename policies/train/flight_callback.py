"""Flights of a policy under training, for the Rerun viewer (`stair-env[rerun]`). Importing this loads SB3."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from perception.looking.rerun_log import load_rerun
from policies.make_env import make_env
from policies.report.flight_log import FlightLog, open_flights
from policies.rollout import run_episode
from stair_env.common.constants import WALKING_DIRECTIONS

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

    from policies.train.training import TrainingConfig


class RerunCallback(BaseCallback):
    """Flies the policy up and down every so often, and writes what happened for the Rerun viewer.

    The flights have an environment of their own, over the whole range of stairs, and the most likely actions: the
    training goes on as if they had not been.

    Args:
        folder: gets `steps_NNNNNNNNN.rrd`.
        config: of the training.

    Raises:
        MissingExtraError: rerun-sdk is not installed.
    """

    def __init__(self, folder: Path, config: TrainingConfig) -> None:
        super().__init__()
        load_rerun()
        self._folder, self._config = folder, config
        self._last = 0

    def _on_training_start(self) -> None:
        self._last = self.model.num_timesteps

    def _on_rollout_start(self) -> None:
        if self.model.num_timesteps - self._last >= self._config.checkpoint_every:
            self._fly()

    def _on_training_end(self) -> None:
        self._fly()

    def _on_step(self) -> bool:
        return True

    def _fly(self) -> None:
        self._last = self.model.num_timesteps
        kwargs = {name: value for name, value in self._config.resolved_env_kwargs().items() if name != "curriculum"}
        asked = kwargs.get("direction", WALKING_DIRECTIONS[0])
        time_s, path = 0.0, self._folder / f"steps_{self.model.num_timesteps:09d}.rrd"
        with open_flights(path) as opened:
            for direction in WALKING_DIRECTIONS if asked == "both" else (asked,):
                env = make_env(self._config.env_id, {**kwargs, "direction": direction}, monitor=False)
                try:
                    log = FlightLog(opened, env, time_s)
                    run_episode(env, _Normalising(self.model), self._config.seed, on_step=log.add)
                    time_s = log.time_s
                finally:
                    env.close()


class _Normalising:
    """The model under training, on observations as an environment gives them."""

    def __init__(self, model: BaseAlgorithm) -> None:
        self._model, self._normalisation = model, model.get_vec_normalize_env()

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """As SB3's."""
        if self._normalisation is not None:
            observation = self._normalisation.normalize_obs(observation)
        return self._model.predict(observation, state, episode_start, deterministic)
