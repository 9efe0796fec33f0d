"""Environments in worker processes as Stable-Baselines3's VecEnv. Importing this loads SB3; the workers never do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorWrapper

from stair_env.common.importing.extras import naming_extras
from stair_env.vector import WorkerVectorEnv

with naming_extras():
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn


class StairSb3VecEnv(VecEnv):
    """Speaks SB3's language to a `stair_env.vector.WorkerVectorEnv`.

    A step returns four values; an episode that ends is followed by the next one's first observation in the same step,
    the last observation is in `info["terminal_observation"]`, and `info["TimeLimit.truncated"]` tells a time limit
    from an end.

    Args:
        vector_env: environments with autoreset_mode="SameStep"; closed with this.

    Raises:
        ValueError: another autoreset mode.
    """

    def __init__(self, vector_env: WorkerVectorEnv) -> None:
        mode = vector_env.metadata["autoreset_mode"]
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode={mode.value!r} must be {AutoresetMode.SAME_STEP.value!r} for SB3")
        self.vector_env = vector_env
        self._pool = vector_env.pool
        super().__init__(vector_env.num_envs, vector_env.single_observation_space, vector_env.single_action_space)
        self.metadata = vector_env.metadata

    def reset(self) -> VecEnvObs:
        """Begin an episode everywhere, with the seeds and options that were set; both are used once."""
        requests = {i: (self._seeds[i], self._options[i] or None) for i in range(self.num_envs)}
        infos = self._pool.reset(requests)
        self.reset_infos = [infos[i] for i in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return self._observation()

    def step_async(self, actions: np.ndarray) -> None:
        """Begin a step with actions (num_envs, action size)."""
        self._pool.begin_step(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Observations by key, rewards float32 (num_envs,), dones bool (num_envs,), one info each."""
        results = self._pool.finish_step()
        pool = self._pool
        dones = pool.terminated | pool.truncated
        infos: list[dict[str, Any]] = []
        for index, result in enumerate(results):
            info = result.info if result.final_info is None else result.final_info
            info["TimeLimit.truncated"] = bool(pool.truncated[index] and not pool.terminated[index])
            if result.final_info is not None:
                info["terminal_observation"] = result.final_observation
                self.reset_infos[index] = result.info
            infos.append(info)
        return self._observation(), pool.rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        """End the workers; safe to call twice."""
        self.vector_env.close()

    def has_attr(self, attr_name: str) -> bool:
        """Whether every environment has the attribute, which need not be one that can be sent."""
        return all(self.env_method("has_wrapper_attr", attr_name))

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of environments.

        Raises:
            AttributeError: there is none of this name.
        """
        return self._pool.get_attribute(self._chosen(indices), attr_name)

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of environments to one value."""
        chosen = self._chosen(indices)
        self._pool.set_attribute(chosen, attr_name, [value] * len(chosen))

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method of environments, for example "get_curriculum_state"."""
        return self._pool.call(self._chosen(indices), method_name, *method_args, **kwargs)

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """Whether environments are wrapped; asks by name, so that no worker imports the class."""
        wanted = (wrapper_class.__module__, wrapper_class.__qualname__)
        return [wanted in classes for classes in self._pool.wrapper_classes(self._chosen(indices))]

    def get_images(self) -> Sequence[np.ndarray | None]:
        """What each environment's `render` returns."""
        return self.env_method("render")

    def _chosen(self, indices: VecEnvIndices) -> list[int]:
        return [int(i) for i in self._get_indices(indices)]

    def _observation(self) -> dict[str, np.ndarray]:
        return {key: value.copy() for key, value in self._pool.observation.items()}


class WrappedSb3VecEnv(StairSb3VecEnv):
    """The same for a `WorkerVectorEnv` within vector wrappers, as `perception.vector_wrapper.PerceptionVectorWrapper`.

    Seeds may differ between the environments, options of a reset may not.

    Args:
        wrapped: vector wrappers around a `WorkerVectorEnv` with autoreset_mode="SameStep"; closed with this.

    Raises:
        ValueError: another vector within, or another autoreset mode.
    """

    def __init__(self, wrapped: VectorWrapper[Any, Any, Any]) -> None:
        if not isinstance(wrapped.unwrapped, WorkerVectorEnv):
            raise ValueError(f"{wrapped} wraps a {type(wrapped.unwrapped).__name__}, must wrap a WorkerVectorEnv")
        super().__init__(wrapped.unwrapped)
        self.wrapped = wrapped
        self.observation_space, self.action_space = wrapped.single_observation_space, wrapped.single_action_space
        self._actions = np.zeros(wrapped.action_space.shape or (), np.float32)

    def reset(self) -> VecEnvObs:
        """Begin an episode everywhere, with the seeds and options that were set; both are used once.

        Raises:
            ValueError: the environments were given different options.
        """
        options = self._options[0]
        if any(other != options for other in self._options):
            raise ValueError(f"options {self._options!r} must be the same for every environment of a wrapped vector")
        vector: Any = self.wrapped  # its annotation knows no list of seeds, its code does
        observations, infos = vector.reset(seed=list(self._seeds), options=options or None)
        self.reset_infos = [one_info(infos, index) for index in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return _copied(observations)

    def step_async(self, actions: np.ndarray) -> None:
        """Remember the actions (num_envs, action size); `step_wait` takes the step."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Observations by key, rewards float32 (num_envs,), dones bool (num_envs,), one info each."""
        observations, rewards, terminated, truncated, batch = self.wrapped.step(self._actions)
        infos: list[dict[str, Any]] = []
        for index in range(self.num_envs):
            info = one_info(batch, index)
            final_observation, final_info = info.pop("final_obs", None), info.pop("final_info", None)
            if final_info is not None:
                self.reset_infos[index] = info
                info = {**final_info, "terminal_observation": final_observation}
            info["TimeLimit.truncated"] = bool(truncated[index] and not terminated[index])
            infos.append(info)
        return _copied(observations), rewards.astype(np.float32), terminated | truncated, infos

    def close(self) -> None:
        """End the workers and what the wrappers hold; safe to call twice."""
        self.wrapped.close()


def _copied(observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """SB3 keeps an observation beyond the next step, which overwrites shared memory."""
    return {key: np.array(value) for key, value in observations.items()}


def one_info(batch: dict[str, Any], index: int) -> dict[str, Any]:
    """One environment's infos out of those that Gymnasium's vector environments batch."""
    info: dict[str, Any] = {}
    for key, mask in batch.items():
        name = key[1:]
        if key.startswith("_") and name in batch and mask[index]:
            column = batch[name]
            value = one_info(column, index) if isinstance(column, dict) else column[index]
            info[name] = value.item() if isinstance(value, np.generic) else value
    return info
