"""Files of a policy in a form that every NumPy reads: the same numbers under public names."""

from __future__ import annotations

import io
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

from policies.make_env import make_env, normalise
from policies.portable import portable, write_pickle
from policies.saved_models import read_pickle

DTYPES = st.sampled_from([np.float32, np.float64, np.uint8, np.int64, np.bool_])


@given(DTYPES.flatmap(lambda dtype: arrays(dtype, array_shapes(min_dims=0, min_side=0))))
def test_arrays_come_back_the_same_and_writable(array: np.ndarray) -> None:
    content = write_pickle({"array": array, "number": np.float64(0.1)})
    assert b"_core" not in content
    for read in (pickle.loads, read_pickle):
        back = read(content)
        assert back["array"].dtype == array.dtype and back["array"].shape == array.shape
        assert back["array"].tobytes() == array.tobytes() and back["array"].flags.writeable
        assert back["number"] == 0.1


def test_spaces_come_back_equal() -> None:
    parts = {"a": gym.spaces.Box(-1, 2, (3,), np.float32), "b": gym.spaces.Box(0, 255, (2, 2), np.uint8)}
    space = gym.spaces.Dict(parts)
    space.seed(1)
    assert read_pickle(write_pickle(space)) == space


def test_a_policy_acts_the_same_in_either_form(toy_id: str) -> None:
    venv = normalise(DummyVecEnv([lambda: make_env(toy_id)]), gamma=0.9)
    model = PPO("MultiInputPolicy", venv, n_steps=64, batch_size=64, seed=0, device="cpu")
    model.learn(64)
    buffer = io.BytesIO()
    model.save(buffer)
    again = PPO.load(io.BytesIO(portable("model.zip", buffer.getvalue())), device="cpu")
    statistics: Any = pickle.loads(portable("vecnormalize.pkl", pickle.dumps(venv)))
    observation, _ = make_env(toy_id).reset(seed=0)
    assert np.array_equal(
        model.predict(venv.normalize_obs(observation), deterministic=True)[0],
        again.predict(statistics.normalize_obs(observation), deterministic=True)[0],
    )
    state, other = model.policy.optimizer.state_dict()["state"], again.policy.optimizer.state_dict()["state"]
    assert all((state[key]["exp_avg"] == other[key]["exp_avg"]).all() for key in state)
