"""A tiny environment with the climbing environments' interface, so that the learning code is tested in seconds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from stair_env.observation import stair_space
from stair_env.task.curriculum import Curriculum, CurriculumConfig

TOY_ID = "ToyClimb-v0"


class ToyClimb(gym.Env):
    """The action must follow the first proprioceptive value; its level counts the episodes."""

    def __init__(self, direction: str = "up", size: int = 3) -> None:
        if direction not in ("up", "down"):
            raise ValueError(f"direction={direction!r} must be one of 'up', 'down'")
        proprio = gym.spaces.Box(-5.0, 5.0, (size,), np.float32)
        self.observation_space = gym.spaces.Dict({"proprio": proprio, "stair": stair_space()})
        self.action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.curriculum = Curriculum(CurriculumConfig(), 0.17)

    def _observation(self) -> dict[str, np.ndarray]:
        self._target = self.np_random.uniform(-1, 1)
        proprio = np.full(self.observation_space["proprio"].shape, self._target, np.float32)
        return {"proprio": proprio, "stair": np.zeros(8, np.float32)}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self._steps = 0
        return self._observation(), {"curriculum_level": self.curriculum.level}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        reward = -float(abs(action[0] - self._target))
        self._steps += 1
        done = self._steps == 10
        if done:
            self.curriculum.level += 1
        info = {"curriculum_level": self.curriculum.level, "is_success": reward > -0.5}
        return self._observation(), reward, done, False, info


@pytest.fixture()
def toy_id() -> Iterator[str]:
    gym.register(TOY_ID, ToyClimb)
    yield TOY_ID
    gym.registry.pop(TOY_ID)
