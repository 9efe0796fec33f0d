"""What rl_zoo3 needs beside a file of hyperparameters. Importing this loads SB3."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback, EvalCallback
from stable_baselines3.common.vec_env import VecEnv

SWITCH = "end_curriculum"  # a method of the environments


class FullHeightEvaluation(BaseCallback):
    """Has the environments of every `EvalCallback` judge on the whole range of stairs.

    rl_zoo3 gives its evaluation the arguments of the training. With `curriculum` among them a policy would be judged,
    and the best one chosen, on the first and lowest riser: those environments never rise a level.
    """

    def _on_training_start(self) -> None:
        for evaluation in _evaluations(self.locals.get("callback")):
            _end_curriculum(evaluation.eval_env)

    def _on_step(self) -> bool:
        return True


def _evaluations(callback: Any) -> Iterator[EvalCallback]:
    """Every `EvalCallback` within a callback, which may be a list of others."""
    if isinstance(callback, EvalCallback):
        yield callback
    for child in getattr(callback, "callbacks", ()):
        yield from _evaluations(child)


def _end_curriculum(venv: VecEnv) -> None:
    if venv.has_attr(SWITCH):
        venv.env_method(SWITCH)
