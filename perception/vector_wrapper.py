"""`PerceptionWrapper` for many environments: the frames of all of them go through the network in one batch."""

from __future__ import annotations

from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from perception.estimator import StairEstimator
from perception.wrapper import NEEDED_KEYS, StairPerception, perceived_info, perceived_observation, perceived_space
from stair_env.camera.intrinsics import Intrinsics
from stair_env.observation import StairBlock
from stair_env.robots import RobotSpec


class SupportsProvideStairs(Protocol):
    """A vector environment that hands every sub-environment its own stair block."""

    def provide_stairs(self, blocks: np.ndarray) -> None:
        """Give (n, 8) blocks to the n gaits."""


class PerceptionVectorWrapper(VectorWrapper):
    """Turns a vector of `StairClimbRGBD-v0` into one with the spaces of `StairClimb-v0`.

    Episodes that begin inside the vector environment, whatever its autoreset mode, are known by their clock, which
    starts anew.

    Args:
        env: vector of RGBD environments with stair_source "external"; either it has `provide_stairs`, or it holds its
            environments in this process (`gymnasium.vector.SyncVectorEnv`).
        robot: that all of them carry.
        intrinsics: of their cameras.
        estimator: None loads StairNetV2 0.25x.

    Raises:
        ValueError: the observations lack what perception needs, or blocks cannot be handed back.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        robot: RobotSpec,
        intrinsics: Intrinsics,
        estimator: StairEstimator | None = None,
    ) -> None:
        super().__init__(env)
        parts = env.single_observation_space.spaces if isinstance(env.single_observation_space, spaces.Dict) else {}
        missing = [key for key in NEEDED_KEYS if key not in parts]
        if missing:
            raise ValueError(f"{env} lacks {', '.join(missing)} in its observations")
        if not hasattr(env, "provide_stairs") and not hasattr(env, "envs"):
            raise ValueError(f"{env} can hand no stair block to its environments: it needs provide_stairs(blocks)")
        single = perceived_space(parts)
        self.single_observation_space = single
        self.observation_space = batch_space(single, env.num_envs)
        self.estimator = estimator if estimator is not None else StairEstimator()
        self.perceptions = [StairPerception(robot, intrinsics) for _ in range(env.num_envs)]
        self._clock = np.full(env.num_envs, np.inf)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode in every environment."""
        vector: Any = self.env  # its annotation knows no list of seeds, its code does
        observations, infos = vector.reset(seed=seed, options=options)
        self._clock[:] = np.inf
        return self._perceive(observations, infos), infos

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One control step in every environment; the network runs once, on all frames that are new."""
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        return self._perceive(observations, infos), rewards, terminations, truncations, infos

    def _perceive(self, observations: dict[str, np.ndarray], infos: dict[str, Any]) -> dict[str, np.ndarray]:
        camera = infos["camera"]
        times, frames, captured = (np.asarray(camera[key]) for key in ("time_s", "frame", "captured_at_s"))
        for index, perception in enumerate(self.perceptions):
            if times[index] <= self._clock[index] and (times[index] < self._clock[index] or times[index] == 0.0):
                perception.reset(float(times[index]))
            perception.feel(observations["proprio"][index], observations["imu"][index], float(times[index]))
        self._clock[:] = times
        new = [i for i, perception in enumerate(self.perceptions) if perception.is_new(int(frames[i]))]
        self._look(new, observations, frames, captured)
        blocks = [perception.block() for perception in self.perceptions]
        arrays = np.stack([block.as_array() for block in blocks])
        self._provide(blocks, arrays)
        infos["perceived"] = [
            perceived_info(block, perception.estimate, int(frames[i]))
            for i, (block, perception) in enumerate(zip(blocks, self.perceptions))
        ]
        return perceived_observation(observations, arrays)

    def _look(
        self, new: list[int], observations: dict[str, np.ndarray], frames: np.ndarray, captured: np.ndarray
    ) -> None:
        chosen = [self.perceptions[i] for i in new]
        estimates = self.estimator.estimate_batch(
            [observations["rgb"][i] for i in new],
            [observations["depth"][i] for i in new],
            [perception.intrinsics for perception in chosen],
            [perception.gravity_at(float(captured[i])) for i, perception in zip(new, chosen)],
        )
        for i, perception, estimate in zip(new, chosen, estimates):
            perception.look(estimate, int(frames[i]), float(captured[i]))

    def _provide(self, blocks: list[StairBlock], arrays: np.ndarray) -> None:
        target: Any = self.env
        if hasattr(target, "provide_stairs"):
            target.provide_stairs(arrays)
            return
        for env, block in zip(target.envs, blocks):
            env.unwrapped.provide_stair(block)


def make_perception_vector(
    num_envs: int, estimator: dict[str, Any] | None = None, **kwargs: Any
) -> PerceptionVectorWrapper:
    """A vector of perceived environments that run in this process.

    Args:
        num_envs: how many.
        estimator: keyword arguments of `StairEstimator`.
        kwargs: of `stair_env.rgbd.StairClimbRgbdEnv`, the same for all.
    """
    from stair_env.rgbd import StairClimbRgbdEnv

    options = {**kwargs, "stair_source": "external"}
    vector = gym.vector.SyncVectorEnv([lambda: StairClimbRgbdEnv(**options) for _ in range(num_envs)])
    first: Any = vector.envs[0].unwrapped
    return PerceptionVectorWrapper(vector, first.robot, first.camera_intrinsics, StairEstimator(**(estimator or {})))
