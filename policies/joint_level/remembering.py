"""Policies that remember: the wrapper they learn with, and what carries the memory when they act.

`Remembering` adds `stair_env.onboard.memory.Memory` to the observation, so that any algorithm can learn with it. A
saved policy brings its own: `policies.pretrained.Policy` acts on environments without the wrapper.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from stair_env.common.validation import SpecError
from stair_env.observation import PROPRIO_SLICES
from stair_env.onboard.memory import MEMORY_BOUND, MEMORY_KEY, MEMORY_SIZE, Memory
from stair_env.robots import DEFAULT_ROBOT, NUM_JOINTS, get_robot

JOINT_PROPRIO_SIZE = PROPRIO_SLICES["last_action"].start + NUM_JOINTS


class Remembering(gym.Wrapper[Any, np.ndarray, Any, np.ndarray]):
    """Adds the key `memory` to the observation of an environment with actuation="joint".

    Args:
        env: a climbing environment.

    Raises:
        SpecError: its observation lacks what is remembered.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self.observation_space = remembering_space(env.observation_space)
        base: Any = env.unwrapped
        self._memory = Memory(base.robot)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode with nothing in mind."""
        observation, info = self.env.reset(seed=seed, options=options)
        return {**observation, MEMORY_KEY: self._memory.begin(observation)}, info

    def step(self, action: np.ndarray) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """One control step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        remembered = {**observation, MEMORY_KEY: self._memory.update(observation)}
        return remembered, reward, terminated, truncated, info


class Recall:
    """Carries the memory of a policy that acts on environments without it.

    Args:
        card: of the policy; says on which robot it learned.

    Raises:
        SpecError: that robot is unknown.
    """

    def __init__(self, card: Mapping[str, Any]) -> None:
        robot = card.get("env_kwargs", {}).get("robot", DEFAULT_ROBOT)
        self._robot = get_robot(robot)

    def add(
        self, observation: Mapping[str, np.ndarray], state: list[Memory] | None, episode_start: Any = None
    ) -> tuple[dict[str, np.ndarray], list[Memory]]:
        """Complete an observation, or a batch of them with a leading axis.

        Args:
            observation: as the environment gives it.
            state: what the last call returned; None begins an episode everywhere.
            episode_start: (n,) or (1,) whether an episode begins, for each of the batch.

        Returns:
            The observation with its memory, and the state for the next call.
        """
        batched = np.ndim(observation["proprio"]) == 2
        batch = observation if batched else {key: value[None] for key, value in observation.items()}
        rows = [dict(zip(batch, values)) for values in zip(*batch.values())]
        fresh = state is None or len(state) != len(rows)
        memories = [Memory(self._robot) for _ in rows] if state is None or fresh else state
        starts = np.ones(len(rows), bool) if fresh else np.broadcast_to(_read_starts(episode_start), len(rows))
        kept = [
            memory.begin(row) if start else memory.update(row) for memory, row, start in zip(memories, rows, starts)
        ]
        return {**observation, MEMORY_KEY: np.stack(kept) if batched else kept[0]}, memories


def _read_starts(episode_start: Any) -> np.ndarray:
    return np.zeros(1, bool) if episode_start is None else np.asarray(episode_start, bool)


def remembers(where: Any) -> bool:
    """Whether an observation, or the space of one, holds a memory."""
    return MEMORY_KEY in (
        where.spaces if isinstance(where, spaces.Dict) else where if isinstance(where, Mapping) else ()
    )


def without_memory(space: gym.Space[Any]) -> spaces.Dict:
    """What an environment gives to a policy that remembers."""
    assert isinstance(space, spaces.Dict)
    return spaces.Dict({key: part for key, part in space.spaces.items() if key != MEMORY_KEY})


def memory_space() -> spaces.Box:
    """Space of the memory."""
    return spaces.Box(-MEMORY_BOUND, MEMORY_BOUND, (MEMORY_SIZE,), np.float32)


def remembering_space(space: gym.Space[Any]) -> spaces.Dict:
    """Space of an observation with its memory.

    Raises:
        SpecError: the observation lacks what is remembered.
    """
    parts = space.spaces if isinstance(space, spaces.Dict) else {}
    if "proprio" not in parts or parts["proprio"].shape != (JOINT_PROPRIO_SIZE,):
        raise SpecError(f'memory=True needs an environment with actuation="joint" and its `proprio`, not {space}')
    return spaces.Dict({**parts, MEMORY_KEY: memory_space()})
