"""The network's view of the stair block."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
import torch

from policies.features import CLIP, STAIR_SCALE, StairFeatures
from stair_env.observation import STAIR_FIELDS, STAIR_HIGH, STAIR_LOW, stair_space

SPACE = gym.spaces.Dict({"proprio": gym.spaces.Box(-1, 1, (4,)), "stair": stair_space()})


def features(stair: np.ndarray) -> np.ndarray:
    observation = {"proprio": torch.ones(len(stair), 4), "stair": torch.as_tensor(stair, dtype=torch.float32)}
    return StairFeatures(SPACE)(observation).numpy()


def test_every_field_has_a_scale() -> None:
    assert tuple(STAIR_SCALE) == STAIR_FIELDS


def test_valid_blocks_are_scaled_and_bounded() -> None:
    rng = np.random.default_rng(0)
    stair = rng.uniform(STAIR_LOW, STAIR_HIGH, (200, 8))
    stair[:, 0] = 1.0
    out = features(stair)
    assert out.shape == (200, 12) and np.array_equal(out[:, :4], np.ones((200, 4)))
    assert np.abs(out).max() <= CLIP
    middle = np.array([[1, 1, 0.30, 0.12, 0.15, 0, 0, 1]])
    assert np.allclose(features(middle)[0, 4:], [1, 1, 0, 0, 0, 0, 0, 1])


def test_an_invalid_block_is_all_zero() -> None:
    assert not features(np.zeros((3, 8)))[:, 4:].any()


def test_other_spaces_are_refused() -> None:
    with pytest.raises(ValueError, match="Dict"):
        StairFeatures(gym.spaces.Box(-1, 1, (3,)))  # type: ignore[arg-type]
