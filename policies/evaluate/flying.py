"""Flying the episodes of an evaluation: jobs, and the processes that do them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym

from policies import pretrained
from policies.evaluate.episode_log import Key
from policies.evaluate.packed_policy import PackedPolicy, pack, unpack
from policies.make_env import make_env
from policies.rollout import CONTROLS, Episode, Predictor, ZeroAction, run_episode
from stair_env.common.tasks import LOCAL, Engine, run_tasks


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


def run_jobs(jobs: Sequence[Job], engine: Engine = LOCAL) -> Iterator[tuple[Job, list[Episode]]]:
    """Results as they come, from this process or from workers that start without its threads.

    Policies travel with the jobs, so that other machines need no such file.
    """
    if engine.in_this_process or not jobs:
        with contextlib.closing(Worker()) as worker:
            for job in jobs:
                yield job, worker.run(job)
        return
    yield from run_tasks(_run_in_worker, jobs, engine, shared=_pack_policies(jobs))


def _pack_policies(jobs: Sequence[Job]) -> dict[str, PackedPolicy]:
    """Files of every policy that jobs name."""
    names = dict.fromkeys(job.policy for job in jobs if job.policy is not None and job.policy not in CONTROLS)
    return {name: pack(name) for name in names}


class Worker:
    """Keeps the environment and the policies between jobs.

    Args:
        packed: policies by name; others are read from their files.
    """

    def __init__(self, packed: Mapping[str, PackedPolicy] | None = None) -> None:
        self._packed = dict(packed or {})
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
        if name not in self._policies:
            packed = self._packed.get(name)
            self._policies[name] = pretrained.load(name, env) if packed is None else unpack(packed, env)
        return self._policies[name]

    def close(self) -> None:
        """Release the environment."""
        if self._env is not None:
            self._env.close()
        self._env = self._key = None


_WORKER: list[tuple[tuple[str, ...], Worker]] = []  # one in each worker process, and whose policies it has


def _run_in_worker(job: Job, packed: Mapping[str, PackedPolicy]) -> list[Episode]:
    """Fly a job in a process that may have flown others, and on a Ray cluster for another evaluation."""
    wanted = tuple(sorted(policy.digest for policy in packed.values()))
    if not _WORKER or _WORKER[0][0] != wanted:
        _limit_torch()
        for _, old in _WORKER:
            old.close()
        _WORKER[:] = [(wanted, Worker(packed))]
    return _WORKER[0][1].run(job)


def _limit_torch() -> None:
    import torch

    torch.set_num_threads(1)
