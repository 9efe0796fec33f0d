"""Spaces of policies and environments: where they differ, and observations as one vector."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np


def flatten(space: gym.spaces.Dict, observation: Mapping[str, Any]) -> np.ndarray:
    """One vector of an observation, as `FlattenObservation` makes it, or one row for each of a batch."""
    parts = []
    for key, part in space.spaces.items():
        values = np.asarray(observation[key])
        batch = values.shape[: values.ndim - len(part.shape or ())]
        parts.append(values.reshape(*batch, -1))
    return np.concatenate(parts, axis=-1)


def describe_difference(trained: gym.Space, given: gym.Space) -> str:
    """In words, how two spaces differ; "" when a policy for one works on the other."""
    if isinstance(trained, gym.spaces.Dict) and isinstance(given, gym.spaces.Dict):
        if set(trained.spaces) != set(given.spaces):
            return f"has keys {sorted(given.spaces)}, the policy was trained on {sorted(trained.spaces)}"
        parts = ((key, describe_difference(space, given.spaces[key])) for key, space in trained.spaces.items())
        return next((f"[{key!r}] {text}" for key, text in parts if text), "")
    if type(trained) is not type(given) or trained.shape != given.shape or trained.dtype != given.dtype:
        return f"is {_brief(given)}, the policy was trained on {_brief(trained)}"
    if isinstance(trained, gym.spaces.Box) and isinstance(given, gym.spaces.Box) and trained != given:
        return "has other bounds than the policy was trained on"
    return ""


def _brief(space: gym.Space) -> str:
    return f"{type(space).__name__} of shape {space.shape}, {space.dtype}"
