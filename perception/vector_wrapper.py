"""`PerceptionWrapper` for many environments: the frames of all of them go through the network in one batch."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from perception.estimator import StairEstimator
from perception.wrapper import NEEDED_KEYS, StairPerception, perceived_info, perceived_observation, perceived_space
from stair_env.intrinsics import Intrinsics
from stair_env.observation import NO_STAIRS, StairBlock
from stair_env.robots import RobotSpec


class SupportsProvideStairs(Protocol):
    """A vector environment that hands every sub-environment its own stair block."""

    def provide_stairs(self, blocks: np.ndarray) -> None:
        """Give (n, 8) float64 blocks to the n gaits."""


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
        self.autoreset_mode = env.metadata.get("autoreset_mode")
        self.single_observation_space = single
        self.observation_space = batch_space(single, env.num_envs)
        self.estimator = estimator if estimator is not None else StairEstimator(refine_gravity=False)
        self.perceptions = [StairPerception(robot, intrinsics) for _ in range(env.num_envs)]
        self._clock = np.full(env.num_envs, np.inf)
        self._blocks = [NO_STAIRS] * env.num_envs

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode in every environment, or in those that options["reset_mask"] chooses."""
        vector: Any = self.env  # its annotation knows no list of seeds, its code does
        observations, infos = vector.reset(seed=seed, options=options)
        self._clock[infos["_camera"]] = np.inf
        return self._perceive(observations, infos), infos

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One control step in every environment; the network runs once, on all frames that are new."""
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        if "final_obs" in infos:
            self._perceive_ends(infos)
        return self._perceive(observations, infos), rewards, terminations, truncations, infos

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of every environment, or read an attribute."""
        vector: Any = self.env
        called: tuple[Any, ...] = vector.call(name, *args, **kwargs)
        return called

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """An attribute of every environment."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of every environment: a list or tuple holds one value each, anything else is for all."""
        vector: Any = self.env
        vector.set_attr(name, values)

    def _perceive(self, observations: dict[str, np.ndarray], infos: dict[str, Any]) -> dict[str, np.ndarray]:
        present = np.flatnonzero(infos["_camera"]).tolist()  # all, but for a reset of some
        moments = {index: _moment(observations, infos["camera"], index) for index in present}
        for index, moment in moments.items():
            if moment.time_s <= self._clock[index] and (moment.time_s < self._clock[index] or moment.time_s == 0.0):
                self.perceptions[index].reset(moment.time_s)
            self._clock[index] = moment.time_s
        for index, block in self._look(moments).items():
            self._blocks[index] = block
            said = perceived_info(block, self.perceptions[index].estimate, moments[index].frame)
            self._add_info(infos, {"perceived": said}, index)
        self._provide(self._blocks)
        return perceived_observation(observations, np.stack([block.as_array() for block in self._blocks]))

    def _perceive_ends(self, infos: dict[str, Any]) -> None:
        """Perceive the last observation of episodes that ended within this step (autoreset mode "SameStep")."""
        ended = np.flatnonzero(infos["_final_obs"]).tolist()
        finals, final_info = infos["final_obs"], infos["final_info"]
        moments = {index: _moment(finals[index], final_info["camera"], index, batched=False) for index in ended}
        for index, block in self._look(moments).items():
            said = perceived_info(block, self.perceptions[index].estimate, moments[index].frame)
            self._add_info(final_info, {"perceived": said}, index)
            finals[index] = perceived_observation(finals[index], block.as_array())

    def _look(self, moments: dict[int, _Moment]) -> dict[int, StairBlock]:
        """Have environments perceive a moment each; the network runs once, on the frames that are new."""
        for index, moment in moments.items():
            self.perceptions[index].feel(moment.proprio, moment.imu, moment.time_s)
        new = [index for index, moment in moments.items() if self.perceptions[index].is_new(moment.frame)]
        chosen = [self.perceptions[index] for index in new]
        seen = [moments[index] for index in new]
        estimates = self.estimator.estimate_batch(
            [moment.rgb for moment in seen],
            [moment.depth for moment in seen],
            [perception.intrinsics for perception in chosen],
            [perception.gravity_at(moment.captured_at_s) for perception, moment in zip(chosen, seen)],
        )
        for perception, moment, estimate in zip(chosen, seen, estimates):
            perception.look(estimate, moment.frame, moment.captured_at_s)
        return {index: self.perceptions[index].block() for index in moments}

    def _provide(self, blocks: list[StairBlock]) -> None:
        target: Any = self.env
        if hasattr(target, "provide_stairs"):
            target.provide_stairs(np.array(blocks))
            return
        for env, block in zip(target.envs, blocks):
            env.unwrapped.provide_stair(block)


class _Moment(NamedTuple):
    """What one environment's sensors say at one control step."""

    proprio: np.ndarray
    imu: np.ndarray
    rgb: np.ndarray
    depth: np.ndarray
    time_s: float
    frame: int
    captured_at_s: float


def _moment(
    observation: dict[str, np.ndarray], camera: dict[str, np.ndarray], index: int, batched: bool = True
) -> _Moment:
    """One environment's part of a batch (of its infos alone if the observation is not batched)."""
    proprio, imu, rgb, depth = (observation[key][index] if batched else observation[key] for key in NEEDED_KEYS)
    time_s, captured_at_s = float(camera["time_s"][index]), float(camera["captured_at_s"][index])
    return _Moment(proprio, imu, rgb, depth, time_s, int(camera["frame"][index]), captured_at_s)
