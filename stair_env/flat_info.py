"""Infos without nesting or text, for clients that put them into tensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np


class FlatInfo(gym.Wrapper):
    """Flattens infos: `info["truth"]["yaw"]` becomes `info["truth_yaw"]`; every value is a NumPy array or scalar.

    Texts are left out: what the end of an episode was is in `is_success`, and in the flags that `step` returns.
    """

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, flatten(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """One control step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, flatten(info)


def flatten(info: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The numbers in an info by name, those in nested ones with the names above them in front."""
    flat: dict[str, Any] = {}
    for key, value in info.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{key}_")
        elif not isinstance(value, str):
            array = np.asarray(value)
            flat[prefix + key] = array if array.shape else array[()]
    return flat
