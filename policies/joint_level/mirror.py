"""Left and right are alike: what is learned on a flight holds on its mirror image, too."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from stair_env.observation import PROPRIO_FIELDS, STAIR_FIELDS
from stair_env.onboard.memory import EDGES, LAGS, MEMORY_KEY, MOMENT_FIELDS, MOMENT_SIZE, STAIR_KEY
from stair_env.robots import NUM_JOINTS
from stair_env.task.terms.height_scan import GRID_X_M, GRID_Y_M, HEIGHT_SCAN_KEY

OTHER_LEG = [1, 0, 3, 2]  # FL in the place of FR, and so on
JOINT_SIGNS = np.tile([-1.0, 1.0, 1.0], 4)  # a hip turns about the x axis, the others about y
_SIGNS = {
    "gravity": np.array([1.0, -1.0, 1.0]),
    "angular_velocity": np.array([-1.0, 1.0, -1.0]),  # a pseudovector
    "velocity": np.array([1.0, -1.0, 1.0]),
    "yaw_rate": np.array([-1.0]),
}


def mirror_joints(values: np.ndarray) -> np.ndarray:
    """Mirror (..., 12) of the joints, canonical order."""
    legs = values.reshape(*values.shape[:-1], 4, 3)[..., OTHER_LEG, :]
    mirrored: np.ndarray = legs.reshape(values.shape) * JOINT_SIGNS.astype(values.dtype)
    return mirrored


def mirror_observation(observation: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Mirror observations (n, ...) of joint-level environments, key by key.

    Raises:
        KeyError: of a key nobody knows how to mirror.
    """
    return {key: _MIRRORS[key](value) for key, value in observation.items()}


def _mirror_field(name: str, values: np.ndarray) -> np.ndarray:
    if name == "phase":  # of a trot's clock: the other legs swing half a cycle later; always (0, 1) without a clock
        return -values if values[..., 0].any() else values
    if name in _SIGNS:
        return values * _SIGNS[name].astype(values.dtype)
    return mirror_joints(values) if values.shape[-1] == NUM_JOINTS else values[..., OTHER_LEG]


def _mirror_fields(lengths: Mapping[str, int], values: np.ndarray) -> np.ndarray:
    bounds = np.cumsum(list(lengths.values()))[:-1]
    parts = np.split(values, bounds, axis=-1)
    return np.concatenate([_mirror_field(name, part) for name, part in zip(lengths, parts)], axis=-1)


_LENGTHS = {name: length for name, (length, _) in PROPRIO_FIELDS.items()} | {"last_action": NUM_JOINTS}


def _mirror_proprio(values: np.ndarray) -> np.ndarray:
    return _mirror_fields(_LENGTHS, values)


def _mirror_memory(values: np.ndarray) -> np.ndarray:
    moments, edges, feet = np.split(values, [EDGES.start, EDGES.stop], axis=-1)
    lengths = {name: _LENGTHS[name] for name in MOMENT_FIELDS}
    mirrored = _mirror_fields(lengths, moments.reshape(len(values), len(LAGS), MOMENT_SIZE))
    other_feet = feet.reshape(len(values), 4, -1)[:, OTHER_LEG].reshape(feet.shape)
    return np.concatenate([mirrored.reshape(moments.shape), edges, other_feet], axis=-1)


def _mirror_stair(values: np.ndarray) -> np.ndarray:
    mirrored = values.copy()
    mirrored[:, STAIR_FIELDS.index("heading_error")] *= -1
    return mirrored


def _mirror_scan(values: np.ndarray) -> np.ndarray:
    mirrored: np.ndarray = values.reshape(len(values), len(GRID_X_M), len(GRID_Y_M))[:, :, ::-1].reshape(values.shape)
    return mirrored


_MIRRORS = {
    "proprio": _mirror_proprio,
    MEMORY_KEY: _mirror_memory,
    STAIR_KEY: _mirror_stair,
    HEIGHT_SCAN_KEY: _mirror_scan,
}


def check_mirrors(observation_space: gym.Space[Any], action_space: gym.Space[Any]) -> None:
    """Refuse what has no mirror image.

    Raises:
        ValueError: the observation holds what nobody knows how to mirror, or the action is not the joints' angles.
    """
    keys = observation_space.spaces if isinstance(observation_space, gym.spaces.Dict) else ("one vector",)
    unknown = [key for key in keys if key not in _MIRRORS]
    if unknown or action_space.shape != (NUM_JOINTS,):
        what = f"observations of {', '.join(unknown)}" if unknown else f"actions of shape {action_space.shape}"
        raise ValueError(f"{what} have no mirror image, only {', '.join(_MIRRORS)} and the {NUM_JOINTS} joints")


def act_both_ways(
    act: Callable[[dict[str, np.ndarray]], np.ndarray], observation: Mapping[str, np.ndarray]
) -> np.ndarray:
    """The mean of what a policy would do, and of the mirror image of what it would do on the mirror image.

    What a network errs by on one side it does not err by on the other, so that the mean errs less (docs/climbing.md).
    Until its memory is full a policy acts on what it sees alone, see `begun`.

    Args:
        act: from observations (n, ...), not normalised, to actions (n, 12).
        observation: by key, with or without a leading axis (n, ...).

    Returns:
        Actions (n, 12), or (12,).
    """
    batched = np.ndim(observation["proprio"]) == 2
    seen = {key: np.asarray(value) if batched else np.asarray(value)[None] for key, value in observation.items()}
    mirrored = mirror_observation(seen)
    action, other = np.split(act({key: np.concatenate([value, mirrored[key]]) for key, value in seen.items()}), 2)
    full = begun(seen[MEMORY_KEY]) if MEMORY_KEY in seen else np.ones(len(action), bool)
    mean = np.where(full[:, None], 0.5 * (action + mirror_joints(other)), action).astype(action.dtype)
    answer: np.ndarray = mean if batched else mean[0]
    return answer


def begun(memory: np.ndarray) -> np.ndarray:
    """(n,) bool: whether the longest remembered moment lies in the episode, from memories (n, MEMORY_SIZE).

    Before, nothing tells a flight from its mirror image but the leg that the teacher begins with, which is always the
    same.
    """
    oldest = (len(LAGS) - 1) * MOMENT_SIZE
    return np.asarray(memory[:, oldest : oldest + NUM_JOINTS].any(axis=1))
