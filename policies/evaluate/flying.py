"""Flying the episodes of an evaluation: jobs, and the processes that do them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym

from policies import pretrained
from policies.evaluate.episode_log import Key
from policies.evaluate.packed_policy import PackedPolicy, pack, unpack
from policies.make_env import PERCEPTION_ID, make_env
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


@dataclass(frozen=True)
class Luggage:
    """What workers bring along to fly jobs.

    Attributes:
        policies: by name; others are read from their files.
        detector: that all perceived environments share; None gives each its own network.
    """

    policies: Mapping[str, PackedPolicy] = field(default_factory=dict)
    detector: Any = None

    @property
    def digest(self) -> str:
        """Equal for equal luggage."""
        return repr((sorted(policy.digest for policy in self.policies.values()), self.detector))


def run_jobs(
    jobs: Sequence[Job], engine: Engine = LOCAL, network_server: bool = False
) -> Iterator[tuple[Job, list[Episode]]]:
    """Results as they come, from this process or from workers that start without its threads.

    Policies travel with the jobs, so that other machines need no such file.

    Args:
        jobs: what to fly.
        engine: where.
        network_server: with Ray, one network for all perceived environments (`perception.inference.frame_server`).
    """
    if engine.in_this_process or not jobs:
        with contextlib.closing(Worker()) as worker:
            for job in jobs:
                yield job, worker.run(job)
        return
    with contextlib.ExitStack() as opened:
        detector = None
        if network_server:
            from perception.inference.frame_server import start_frame_server
            from stair_env.common.tasks.ray_pool import ray_session

            opened.enter_context(ray_session(engine))
            detector = start_frame_server()
        luggage = Luggage(_pack_policies(jobs), detector)
        yield from run_tasks(_run_in_worker, jobs, engine, shared=luggage)


def _pack_policies(jobs: Sequence[Job]) -> dict[str, PackedPolicy]:
    """Files of every policy that jobs name."""
    names = dict.fromkeys(job.policy for job in jobs if job.policy is not None and job.policy not in CONTROLS)
    return {name: pack(name) for name in names}


class Worker:
    """Keeps the environment and the policies between jobs.

    Args:
        luggage: what it does not find here.
    """

    def __init__(self, luggage: Luggage | None = None) -> None:
        self._luggage = luggage or Luggage()
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
            self._env, self._key = make_env(job.env_id, self._env_kwargs(job), monitor=False), key
        return self._env

    def _env_kwargs(self, job: Job) -> dict[str, Any]:
        """A job's, with the shared network where there is one."""
        if self._luggage.detector is None or job.env_id != PERCEPTION_ID:
            return job.env_kwargs
        estimator = {**job.env_kwargs.get("estimator", {}), "detector": self._luggage.detector}
        return {**job.env_kwargs, "estimator": estimator}

    def _policy(self, name: str | None, env: gym.Env) -> Predictor:
        if name is None:
            return ZeroAction(env.action_space)
        if name in CONTROLS:
            return CONTROLS[name](env.action_space)
        if name not in self._policies:
            packed = self._luggage.policies.get(name)
            self._policies[name] = pretrained.load(name, env) if packed is None else unpack(packed, env)
        return self._policies[name]

    def close(self) -> None:
        """Release the environment."""
        if self._env is not None:
            self._env.close()
        self._env = self._key = None


_WORKER: list[tuple[str, Worker]] = []  # one in each worker process, and which luggage it has


def _run_in_worker(job: Job, luggage: Luggage) -> list[Episode]:
    """Fly a job in a process that may have flown others, and on a Ray cluster for another evaluation."""
    if not _WORKER or _WORKER[0][0] != luggage.digest:
        _limit_torch()
        for _, old in _WORKER:
            old.close()
        _WORKER[:] = [(luggage.digest, Worker(luggage))]
    return _WORKER[0][1].run(job)


def _limit_torch() -> None:
    import torch

    torch.set_num_threads(1)
