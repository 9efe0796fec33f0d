"""Differences of spaces in words, observations as one vector."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from policies.spaces import describe_difference, flatten

BOX = gym.spaces.Box(-1, 1, (2,))


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (gym.spaces.Dict({"a": BOX}), ""),
        (gym.spaces.Dict({"b": BOX}), "keys"),
        (gym.spaces.Dict({"a": gym.spaces.Box(-1, 2, (2,))}), "bounds"),
        (gym.spaces.Dict({"a": gym.spaces.Box(-1, 1, (2,), np.float64)}), "float64"),
        (BOX, "Dict"),
    ],
)
def test_differences_are_described(given: gym.Space, expected: str) -> None:
    text = describe_difference(gym.spaces.Dict({"a": BOX}), given)
    assert expected in text and bool(text) == bool(expected)


def test_one_vector_is_what_gymnasium_makes_one_by_one_and_in_batches() -> None:
    space = gym.spaces.Dict({"a": BOX, "b": gym.spaces.Box(-1, 1, (2, 3))})
    space.seed(0)
    rows = [space.sample() for _ in range(4)]
    whole = flatten(space, {key: np.stack([row[key] for row in rows]) for key in rows[0]})
    assert np.array_equal(whole, [gym.spaces.flatten(space, row) for row in rows])
    assert np.array_equal(flatten(space, rows[0]), whole[0])
