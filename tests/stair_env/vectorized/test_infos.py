"""Batched infos are Gymnasium's own."""

import numpy as np
import pytest
from gymnasium.vector import VectorEnv
from hypothesis import given
from hypothesis import strategies as st

from stair_env.vectorized.infos import batch_infos

KINDS = {
    "number": st.floats(-1, 1),
    "count": st.integers(-5, 5),
    "flag": st.booleans(),
    "name": st.text(max_size=3),
    "place": st.lists(st.floats(-1, 1), min_size=3, max_size=3),
    "array": st.lists(st.floats(-1, 1), min_size=2, max_size=2).map(np.array),
    "terms": st.fixed_dictionaries({"first": st.floats(-1, 1)}, optional={"last": st.integers(0, 4)}),
    "final_obs": st.fixed_dictionaries({"state": st.floats(-1, 1).map(np.float32)}),
}
info = st.fixed_dictionaries({}, optional=KINDS)


class Plain(VectorEnv):
    def __init__(self, num_envs):
        self.num_envs = num_envs


def gymnasiums(infos, num_envs):
    env, batch = Plain(num_envs), {}
    for index, one in infos.items():
        batch = env._add_info(batch, one, index)
    return batch


def assert_same(ours, theirs):
    assert type(ours) is type(theirs)
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys()
        for key in ours:
            assert_same(ours[key], theirs[key])
    elif isinstance(ours, np.ndarray) and ours.dtype == object:
        for a, b in zip(ours, theirs, strict=True):
            assert_same(a, b)
    elif isinstance(ours, np.ndarray):
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs)
    else:
        assert ours == theirs


@given(st.lists(info, min_size=1, max_size=4), st.integers(0, 2))
def test_batches_are_gymnasiums(rows, missing):
    infos = dict(enumerate(rows[missing:] or rows, start=missing if rows[missing:] else 0))
    num_envs = max(infos) + 1
    assert_same(batch_infos(infos, num_envs), gymnasiums(infos, num_envs))


@given(st.fixed_dictionaries(KINDS), st.integers(1, 5))
def test_equal_environments_take_the_short_way_to_the_same(row, count):
    infos = {index: row for index in range(count)}
    assert_same(batch_infos(infos, count), gymnasiums(infos, count))


def test_nothing_gives_nothing():
    assert batch_infos({}, 3) == {}


@pytest.mark.parametrize("order", [("a", "b"), ("b", "a")])
def test_the_order_of_keys_does_not_matter(order):
    infos = {0: {"a": 1, "b": 2.0}, 1: {key: {"a": 3, "b": 4.0}[key] for key in order}}
    assert_same(batch_infos(infos, 2), gymnasiums(infos, 2))
