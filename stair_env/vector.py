"""Many environments as one, stepped by a few processes: what `gymnasium.make_vec` returns for our ids.

`gym.make_vec("stair_env/StairClimb-v0", num_envs=8)` makes one. Seeds, time limit, observations, rewards, flags and
infos are those of `gymnasium.vector.SyncVectorEnv` over the same environments.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

import stair_env
from stair_env.common.validation import check_choice
from stair_env.vectorized.infos import FINAL_OBSERVATION, batch_infos
from stair_env.vectorized.pool import WorkerPool
from stair_env.vectorized.worker import EnvFactory, StepInfo

RESET_MASK = "reset_mask"  # Gymnasium's option that names the environments to reset
OWN_METHODS = ("reset", "step", "close")
VectorStep = tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]


class WorkerVectorEnv(VectorEnv[dict[str, np.ndarray], np.ndarray, np.ndarray]):
    """Environments in worker processes as a Gymnasium vector environment.

    Args:
        factories: one per environment, of equal spaces; called in the workers, the first one also here to learn them.
        autoreset_mode: "NextStep" (Gymnasium's default), "SameStep" or "Disabled", or the AutoresetMode.
        workers: number of processes that step; None takes the number of cores, at most one per environment.
        caller_steps: whether the calling process is one of them, instead of waiting for as many others. An environment
            that takes its process down takes the caller down too.
        context: "fork", "forkserver" or "spawn"; None takes "forkserver" where there is one, else "spawn".
        copy: whether observations are copies; if not, they are the shared memory that the next step overwrites.
        timeout_s: how long a worker may take for one request.

    Raises:
        ValueError: an argument is wrong; the message names it, its value and the choices.
        WorkerError: (a RuntimeError, here and in every method) a worker died, fell silent or its environment raised;
            the message names the worker and the cause.
    """

    def __init__(
        self,
        factories: Sequence[EnvFactory],
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        workers: int | None = None,
        caller_steps: bool = False,
        context: str | None = None,
        copy: bool = True,
        timeout_s: float = 300.0,
    ) -> None:
        mode = _read_autoreset_mode(autoreset_mode)
        if not factories:
            raise ValueError("num_envs=0 must be >= 1")
        probe = factories[0]()
        self.num_envs = len(factories)
        self.metadata = {**probe.metadata, "autoreset_mode": mode}
        self.render_mode = probe.render_mode
        observation_space, action_space = probe.observation_space, probe.action_space
        probe.close()
        if not isinstance(observation_space, spaces.Dict) or not isinstance(action_space, spaces.Box):
            raise ValueError(f"spaces {observation_space} and {action_space} must be a Dict of Boxes and a Box")
        self.single_observation_space, self.single_action_space = observation_space, action_space
        self.observation_space = batch_space(observation_space, self.num_envs)
        self.action_space = batch_space(action_space, self.num_envs)
        self.autoreset_mode, self._copy = mode, copy
        self._ended = np.zeros(self.num_envs, bool)
        self._pool = WorkerPool(
            factories,
            observation_space,
            action_space,
            autoreset=mode.name.lower(),
            workers=workers,
            caller_steps=caller_steps,
            context=context,
            timeout_s=timeout_s,
        )

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The seed of every environment, as Gymnasium's vector environments have it."""
        return tuple(self._pool.get_attribute(range(self.num_envs), "np_random_seed"))

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The generator of every environment; those of other processes are copies."""
        return tuple(self._pool.get_attribute(range(self.num_envs), "np_random"))

    @property
    def pool(self) -> WorkerPool:
        """The worker processes."""
        return self._pool

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode in each environment.

        Args:
            seed: environment i is seeded with seed + i, or with its own of a list.
            options: of each environment's reset; "reset_mask", (num_envs,) bool, chooses the environments to reset.

        Raises:
            ValueError: not one seed per environment, or a mask of a wrong shape.
            TypeError: a mask that is no bool array.
        """
        seeds = self._seeds(seed)
        options = None if options is None else dict(options)
        mask = self._reset_mask(None if options is None else options.pop(RESET_MASK, None))
        indices = np.flatnonzero(mask).tolist()
        infos = self._pool.reset({i: (seeds[i], options) for i in indices})
        self._ended[mask] = False
        return self._observation(), batch_infos(infos, self.num_envs)

    def step(self, actions: np.ndarray) -> VectorStep:
        """One control step of each environment.

        Args:
            actions: (num_envs, action size) in [-1, 1].

        Returns:
            Observations by key (num_envs, ...), rewards (num_envs,) float64, terminated and truncated (num_envs,) bool,
            and the infos as Gymnasium batches them.
        """
        self.step_async(actions)
        return self.step_wait()

    def step_async(self, actions: np.ndarray) -> None:
        """Begin a step; `step_wait` ends it."""
        if self.autoreset_mode is AutoresetMode.DISABLED and self._ended.any():
            ended = np.flatnonzero(self._ended).tolist()
            raise gym.error.ResetNeeded(f"autoreset is disabled: reset environments {ended} before the next step")
        self._pool.begin_step(actions)

    def step_wait(self) -> VectorStep:
        """The results of the step that `step_async` began."""
        infos = batch_infos(dict(enumerate(map(_step_info, self._pool.finish_step()))), self.num_envs)
        pool = self._pool
        terminated, truncated = pool.terminated.copy(), pool.truncated.copy()
        self._ended = terminated | truncated
        return self._observation(), pool.rewards.copy(), terminated, truncated, infos

    def provide_stairs(self, blocks: np.ndarray) -> None:
        """Give each gait the stair block that it reads at the next step (environments with stair_source="external").

        Args:
            blocks: (num_envs, 8), fields as in `stair_env.observation.STAIR_FIELDS`.

        Raises:
            ValueError: wrong shape.
        """
        self._pool.provide_stairs(blocks)

    def render(self) -> tuple[Any, ...]:
        """What each environment's `render` returns."""
        return self.call("render")

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of every environment, or read an attribute.

        Raises:
            AttributeError: there is no such attribute.
            ValueError: the method is one that this class has for itself.
        """
        check_callable(name)
        return tuple(self._pool.call(range(self.num_envs), name, *args, **kwargs))

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """An attribute of every environment."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of every environment: a list or tuple holds one value each, anything else is for all."""
        if not isinstance(values, list | tuple):
            values = [values] * self.num_envs
        if len(values) != self.num_envs:
            raise ValueError(f"values has {len(values)} entries, must have num_envs={self.num_envs}")
        self._pool.set_attribute(range(self.num_envs), name, values)

    def close_extras(self, **kwargs: Any) -> None:
        """End the workers (`close` calls this once)."""
        pool = getattr(self, "_pool", None)
        if pool is not None:  # else construction failed, and the base class closes what there is of it
            pool.close()

    def _observation(self) -> dict[str, np.ndarray]:
        shared = self._pool.observation
        return {key: value.copy() for key, value in shared.items()} if self._copy else dict(shared)

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        seeds: list[int | None]
        whole = isinstance(seed, (int, np.integer))
        seeds = [int(seed) + i for i in range(self.num_envs)] if whole else list(seed)  # type: ignore[arg-type]
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed has {len(seeds)} entries, must have num_envs={self.num_envs}")
        return seeds

    def _reset_mask(self, mask: Any) -> np.ndarray:
        if mask is None:
            return np.ones(self.num_envs, bool)
        wanted = f"option {RESET_MASK}={mask!r} must be a bool array of shape ({self.num_envs},)"
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            raise TypeError(wanted)
        if mask.shape != (self.num_envs,):
            raise ValueError(wanted)
        if not mask.any():
            raise ValueError(f"option {RESET_MASK}={mask!r} must choose at least one environment")
        return mask


def check_callable(name: str) -> None:
    """Refuse methods that would go past the vector.

    Raises:
        ValueError: name is one of them.
    """
    if name in OWN_METHODS:
        raise ValueError(f"call({name!r}) would leave the vector out of step: use its own {name}()")


def _step_info(result: StepInfo) -> dict[str, Any]:
    """One environment's infos with, where an episode ended within the step, the last observation and info of it."""
    if result.final_info is None:
        return result.info
    return {FINAL_OBSERVATION: result.final_observation, "final_info": result.final_info, **result.info}


def make_climb_vec(num_envs: int = 1, **kwargs: Any) -> WorkerVectorEnv:
    """The vector form of `stair_env/StairClimb-v0`, whose caller steps too unless told; see `make_worker_vec`."""
    return make_worker_vec("stair_env/StairClimb-v0", num_envs, **{"caller_steps": True, **kwargs})


def make_rgbd_vec(num_envs: int = 1, **kwargs: Any) -> WorkerVectorEnv:
    """The vector form of `stair_env/StairClimbRGBD-v0`; see `make_worker_vec`."""
    return make_worker_vec("stair_env/StairClimbRGBD-v0", num_envs, **kwargs)


def make_worker_vec(
    env_id: str,
    num_envs: int,
    *,
    max_episode_steps: int | None = stair_env.MAX_EPISODE_STEPS,
    autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    workers: int | None = None,
    caller_steps: bool = False,
    context: str | None = None,
    copy: bool = True,
    timeout_s: float = 300.0,
    **env_kwargs: Any,
) -> WorkerVectorEnv:
    """Build a vector of one registered id.

    Args:
        env_id: the id.
        num_envs: how many environments.
        max_episode_steps: time limit, as `gymnasium.make` applies it; None takes the id's own.
        autoreset_mode, workers, caller_steps, context, copy, timeout_s: see `WorkerVectorEnv`.
        env_kwargs: keyword arguments of each environment.

    Raises:
        ValueError: an argument is wrong.
        WorkerError: the workers could not be started.
    """
    if num_envs < 1:
        raise ValueError(f"num_envs={num_envs!r} must be >= 1")
    factory = functools.partial(
        gym.make, env_id, max_episode_steps=max_episode_steps, disable_env_checker=True, **env_kwargs
    )
    return WorkerVectorEnv(
        [factory] * num_envs,
        autoreset_mode=autoreset_mode,
        workers=workers,
        caller_steps=caller_steps,
        context=context,
        copy=copy,
        timeout_s=timeout_s,
    )


def _read_autoreset_mode(value: str | AutoresetMode) -> AutoresetMode:
    if isinstance(value, AutoresetMode):
        return value
    check_choice("autoreset_mode", value, tuple(mode.value for mode in AutoresetMode))
    return AutoresetMode(value)
