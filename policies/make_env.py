"""Building environments for Stable-Baselines3: by id and keyword arguments, one or many, normalised."""

from __future__ import annotations

import functools
import multiprocessing
import os
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import gymnasium as gym

import stair_env  # noqa: F401  (registers the ids, also in a worker process)
from stair_env.common.constants import VEC_KINDS
from stair_env.common.importing.extras import naming_extras
from stair_env.observation import PRIVILEGED_KEY

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv, VecNormalize

CLIMB_ID = "stair_env/StairClimb-v0"
PERCEPTION_ID = "stair_env/StairClimbPerception-v0"
RGBD_ID = "stair_env/StairClimbRGBD-v0"
ENV_IDS = (CLIMB_ID, PERCEPTION_ID)
WRAPPING_KEYWORDS = frozenset({"memory", "teacher"})  # of `make_env`: wrappers that read the stair block in the worker
NORMALISED_KEYS = ("proprio", PRIVILEGED_KEY)
_PRELOADED = ["stable_baselines3.common.vec_env.subproc_vec_env", "policies.make_env"]


class CurriculumAccess(gym.Wrapper):
    """Lets a vector of environments read and set each one's curriculum, for checkpoints."""

    def get_curriculum_state(self) -> dict[str, Any] | None:
        """JSON-able state; None where there is no curriculum."""
        curriculum = getattr(self.unwrapped, "curriculum", None)
        return None if curriculum is None else curriculum.state()

    def set_curriculum_state(self, state: Mapping[str, Any] | None) -> None:
        """Continue from `get_curriculum_state()`."""
        curriculum = getattr(self.unwrapped, "curriculum", None)
        if curriculum is not None and state is not None:
            curriculum.restore(state)


@naming_extras()
def make_env(env_id: str, env_kwargs: Mapping[str, Any] | None = None, *, monitor: bool = True) -> gym.Env:
    """Build one environment.

    Args:
        env_id: a registered id.
        env_kwargs: keyword arguments of the environment, and "memory": True for `policies.joint_level.remembering`,
            "teacher": one of `policies.joint_level.teaching.TEACHERS`, or True for the gait.
        monitor: wrap in SB3's Monitor, which reports return and length of each episode in `info["episode"]`.

    Raises:
        ValueError: a keyword argument has a wrong value.
        gymnasium.error.Error: unknown id.
    """
    arguments = dict(env_kwargs or {})
    memory, teacher = arguments.pop("memory", False), arguments.pop("teacher", None)
    env: gym.Env = CurriculumAccess(gym.make(env_id, disable_env_checker=True, **arguments))
    if memory:
        from policies.joint_level.remembering import Remembering

        env = Remembering(env)
    if teacher:
        from policies.joint_level.teaching import Teaching

        env = Teaching(env, "gait" if teacher is True else teacher)
    if not monitor:
        return env
    from stable_baselines3.common.monitor import Monitor

    wrapped: gym.Env = Monitor(env)
    return wrapped


@naming_extras()
def make_vec_env(
    env_id: str,
    num_envs: int,
    env_kwargs: Mapping[str, Any] | None = None,
    *,
    seed: int = 0,
    kind: str = "auto",
) -> VecEnv:
    """Build SB3's vector of environments.

    Args:
        env_id: a registered id.
        num_envs: how many.
        env_kwargs: keyword arguments, the same for each.
        seed: environment i is seeded with seed + i at its first reset.
        kind: "subproc" (one process each, started safely from a thread-free server), "dummy" (this process), "workers"
            (one process per core, each with its share of the environments; without cameras this process is one of them,
            with cameras the frames of all go through the network here, in one batch; see `stair_env.vector`) or "auto"
            ("workers" on several cores, else "dummy").

    Raises:
        ValueError: wrong kind or count, or a keyword argument of the environment is wrong.
    """
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

    if kind not in VEC_KINDS:
        raise ValueError(f"kind={kind!r} must be one of {', '.join(VEC_KINDS)}")
    if num_envs < 1:
        raise ValueError(f"num_envs={num_envs!r} must be >= 1")
    if kind == "auto":  # not a process each: a physics step is shorter than a round trip
        kind = "workers" if (os.cpu_count() or 1) > 1 and num_envs > 1 else "dummy"
    venv: VecEnv
    factory = functools.partial(make_env, env_id, dict(env_kwargs or {}))
    if kind == "workers":
        venv = _make_worker_env(env_id, num_envs, dict(env_kwargs or {}))
        venv.seed(seed)
        return venv
    factory().close()  # a wrong argument is reported here, in one piece, and not by a dying worker
    factories: list[Callable[[], gym.Env]] = [factory] * num_envs
    venv = (
        DummyVecEnv(factories) if kind == "dummy" else SubprocVecEnv(factories, start_method=_prepared_start_method())
    )
    venv.seed(seed)
    return venv


def _make_worker_env(env_id: str, num_envs: int, env_kwargs: dict[str, Any]) -> VecEnv:
    from stable_baselines3.common.vec_env import VecMonitor

    from policies.vec_adapter import StairSb3VecEnv, WrappedSb3VecEnv
    from stair_env.vector import WorkerVectorEnv

    def vector_of(factory_id: str, kwargs: dict[str, Any]) -> WorkerVectorEnv:
        factory = functools.partial(make_env, factory_id, kwargs, monitor=False)
        return WorkerVectorEnv(
            [factory] * num_envs, autoreset_mode="SameStep", caller_steps=env_id == CLIMB_ID, copy=False
        )

    if env_id != PERCEPTION_ID or env_kwargs.keys() & WRAPPING_KEYWORDS:
        return VecMonitor(StairSb3VecEnv(vector_of(env_id, env_kwargs)))
    from perception.gym_entry_points import perceive_vector

    return VecMonitor(WrappedSb3VecEnv(perceive_vector(functools.partial(vector_of, RGBD_ID), env_kwargs)))


def _prepared_start_method() -> str:
    """A start method that copies no threads; a fork server loads the libraries once for all workers."""
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # read by libraries at load, so this process keeps its own setting
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return "spawn"
    multiprocessing.set_forkserver_preload(_PRELOADED)
    return "forkserver"


@naming_extras()
def normalise(venv: VecEnv, *, gamma: float, options: Mapping[str, Any] | None = None) -> VecNormalize:
    """Wrap in VecNormalize; of a Dict observation the stair block alone is left as it is.

    Args:
        venv: environments.
        gamma: discount of the return whose spread scales the reward.
        options: arguments of VecNormalize that differ from these defaults.
    """
    from stable_baselines3.common.vec_env import VecNormalize

    chosen: dict[str, Any] = {"gamma": gamma}
    if isinstance(venv.observation_space, gym.spaces.Dict):
        chosen["norm_obs_keys"] = [key for key in NORMALISED_KEYS if key in venv.observation_space.spaces]
    return VecNormalize(venv, **{**chosen, **dict(options or {})})
