"""What is called on RLlib's environment runners and learners, wherever these run."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from policies.make_env import make_env
from policies.train.rllib.run_state import Report, Reporting, RunState

MODULE = "default_policy"  # RLlib's name of the only one


@dataclass(frozen=True)
class ReportingEnv:
    """Makes an environment for a runner.

    Attributes:
        env_id, env_kwargs: of `policies.make_env.make_env`.
        keys, gamma, norm_reward: of `Reporting`.
    """

    env_id: str
    env_kwargs: Mapping[str, Any]
    keys: Sequence[str]
    gamma: float
    norm_reward: bool

    def __call__(self, context: Any = None) -> Reporting:
        """Make one; RLlib's context is not needed."""
        env = make_env(self.env_id, self.env_kwargs, monitor=False)
        return Reporting(env, self.keys, self.gamma, self.norm_reward)


def collect(algorithm: Any) -> list[Report]:
    """What each environment has met since the last call; a runner that is gone has met nothing."""
    found = algorithm.env_runner_group.foreach_env_runner(_collect_here)
    return [report for reports in found for report in reports]


def share(algorithm: Any, run: RunState, runners: Sequence[int] | None = None) -> None:
    """Give the run's sums to environments and modules.

    Args:
        algorithm: RLlib's.
        run: what is given.
        runners: indices of the runners that get it; None gives it to all, and to the learner.
    """
    arguments: dict[str, Any] = {
        "curriculum": run.curriculum_state(),
        "return_var": float(run.returns.var),
        "statistics": run.statistics(),
    }
    chosen: dict[str, Any] = {} if runners is None else {"remote_worker_ids": list(runners), "local_env_runner": False}
    algorithm.env_runner_group.foreach_env_runner(functools.partial(_share_here, **arguments), **chosen)
    if runners is None:
        algorithm.learner_group.foreach_learner(_set_statistics, statistics=run.statistics())


def share_with_new(*, algorithm: Any, env_runner_indices: Sequence[int], is_evaluation: bool, **kwargs: Any) -> None:
    """RLlib's callback when lost runners were replaced."""
    run = getattr(algorithm, "stair_run", None)
    if run is not None and not is_evaluation:
        share(algorithm, run, env_runner_indices)


def module_state(algorithm: Any) -> dict[str, np.ndarray]:
    """The module's parameters and statistics by name."""
    results = algorithm.learner_group.foreach_learner(_state_here)
    state: dict[str, np.ndarray] = next(iter(results)).get()
    return state


def _environments(runner: Any) -> list[Any]:
    return [] if runner.env is None else list(runner.env.unwrapped.envs)


def _collect_here(runner: Any) -> list[Report]:
    return [env.get_wrapper_attr("collect")() for env in _environments(runner)]


def _share_here(runner: Any, curriculum: Any, return_var: float, statistics: Any) -> None:
    for env in _environments(runner):
        env.get_wrapper_attr("share")(curriculum, return_var)
    module = getattr(runner, "module", None)
    if module is not None:
        module.normaliser.set_statistics(statistics)


def _set_statistics(learner: Any, statistics: Any) -> None:
    learner.module[MODULE].unwrapped().normaliser.set_statistics(statistics)


def _state_here(learner: Any) -> dict[str, np.ndarray]:
    state = learner.module[MODULE].unwrapped().state_dict()
    return {name: value.detach().cpu().numpy() for name, value in state.items()}
