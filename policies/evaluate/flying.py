"""Flying the episodes of an evaluation: jobs, and the processes that do them."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from typing import Any

import gymnasium as gym

from policies.evaluate.episode_log import Key
from policies.make_env import make_env
from policies.rollout import CONTROLS, Episode, Predictor, ZeroAction, run_episode


@dataclass(frozen=True)
class Job:
    """Some episodes of one cell with one source."""

    source: str
    cell_index: int
    env_id: str
    env_kwargs: dict[str, Any]
    options: dict[str, Any]
    policy: str | None
    seeds: tuple[int, ...]

    def key(self, seed: int) -> Key:
        """Of one of its episodes, in an `EpisodeLog`."""
        return self.source, self.policy, self.cell_index, seed


def run_jobs(jobs: Sequence[Job], workers: int) -> Iterator[tuple[Job, list[Episode]]]:
    """Results as they come, from this process or from workers that start without its threads."""
    if workers == 1 or not jobs:
        with contextlib.closing(Worker()) as worker:
            for job in jobs:
                yield job, worker.run(job)
        return
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # read by the workers' libraries at load
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(workers, len(jobs)), mp_context=context) as pool:
        pending = {pool.submit(_run_in_worker, job): job for job in jobs}
        try:
            for done in as_completed(pending):
                yield pending[done], done.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


class Worker:
    """Keeps the environment and the policies between jobs."""

    def __init__(self) -> None:
        self._key: Any = None
        self._env: gym.Env | None = None
        self._policies: dict[str, Predictor] = {}

    def prepare(self, job: Job) -> tuple[gym.Env, Predictor]:
        """What flies a job."""
        env = self._environment(job)
        return env, self._policy(job.policy, env)

    def run(self, job: Job) -> list[Episode]:
        """Fly a job."""
        env, policy = self.prepare(job)
        return [run_episode(env, policy, seed, options=job.options) for seed in job.seeds]

    def _environment(self, job: Job) -> gym.Env:
        key = (job.env_id, repr(sorted(job.env_kwargs.items())))
        if key != self._key or self._env is None:
            self.close()
            self._env, self._key = make_env(job.env_id, job.env_kwargs, monitor=False), key
        return self._env

    def _policy(self, name: str | None, env: gym.Env) -> Predictor:
        if name is None:
            return ZeroAction(env.action_space)
        if name in CONTROLS:
            return CONTROLS[name](env.action_space)
        from policies import pretrained

        if name not in self._policies:
            self._policies[name] = pretrained.load(name, env)
        return self._policies[name]

    def close(self) -> None:
        """Release the environment."""
        if self._env is not None:
            self._env.close()
        self._env = self._key = None


_WORKER: list[Worker] = []  # one in each worker process


def _run_in_worker(job: Job) -> list[Episode]:
    if not _WORKER:
        _limit_torch()
        _WORKER.append(Worker())
    return _WORKER[0].run(job)


def _limit_torch() -> None:
    import torch

    torch.set_num_threads(1)
