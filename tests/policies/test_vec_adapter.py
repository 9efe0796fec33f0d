"""Worker processes as SB3's VecEnv: the same as SB3's own, curriculum access included."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import cloudpickle
import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from policies.make_env import CLIMB_ID, PERCEPTION_ID, CurriculumAccess, make_vec_env
from policies.train.checkpoints import curriculum_states, restore_curriculum
from policies.vec_adapter import StairSb3VecEnv, WrappedSb3VecEnv
from stair_env.task.curriculum import Curriculum, CurriculumConfig
from stair_env.vector import WorkerVectorEnv

cloudpickle.register_pickle_by_value(sys.modules[__name__])  # workers need not be able to import the tests


class Walk(gym.Env):
    """A random walk that ends at ±1; its curriculum counts the ends."""

    def __init__(self) -> None:
        self.observation_space = gym.spaces.Dict({"x": gym.spaces.Box(-9.0, 9.0, (1,), np.float32)})
        self.action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.curriculum = Curriculum(CurriculumConfig(), 0.17)

    def _observation(self) -> dict[str, np.ndarray]:
        return {"x": np.array([self.x], np.float32)}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.x = (options or {}).get("x", 0.0)
        return self._observation(), {"begin": float(self.np_random.random())}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.x += float(action[0]) + float(self.np_random.normal(0.0, 0.3))
        ended = abs(self.x) > 1
        self.curriculum.level += ended
        return self._observation(), -abs(self.x), ended, False, {"is_success": self.x > 1}


def make_walk() -> gym.Env:
    return CurriculumAccess(gym.wrappers.TimeLimit(Walk(), 6))


@pytest.fixture()
def ours() -> Iterator[StairSb3VecEnv]:
    venv = StairSb3VecEnv(WorkerVectorEnv([make_walk] * 3, autoreset_mode="SameStep", workers=2, context="fork"))
    yield venv
    venv.close()


def test_is_sb3s_own_vector(ours: StairSb3VecEnv) -> None:
    theirs = DummyVecEnv([make_walk] * 3)
    rng, ends, cut = np.random.default_rng(0), 0, 0
    for venv in (ours, theirs):
        venv.seed(5)
        venv.set_options({"x": 0.5})
    np.testing.assert_array_equal(ours.reset()["x"], theirs.reset()["x"])
    for _ in range(40):
        actions = rng.uniform(-0.6, 0.6, (3, 1)).astype(np.float32)
        (x, rewards, dones, infos), wanted = ours.step(actions), theirs.step(actions)
        np.testing.assert_array_equal(x["x"], wanted[0]["x"])
        np.testing.assert_array_equal(rewards, wanted[1])
        np.testing.assert_array_equal(dones, wanted[2])
        assert rewards.dtype == wanted[1].dtype and dones.dtype == wanted[2].dtype
        assert infos == wanted[3] and ours.reset_infos == theirs.reset_infos
        ends += int(dones.sum())
        cut += sum(info["TimeLimit.truncated"] for info in infos)
    assert 0 < cut < ends


class Doubled(gym.vector.VectorWrapper):
    """A vector wrapper that changes what is observed."""

    def __init__(self, env: WorkerVectorEnv) -> None:
        super().__init__(env)
        self.autoreset_mode = env.autoreset_mode

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        observations, infos = self.env.reset(seed=seed, options=options)
        return {"x": 2.0 * observations["x"]}, infos

    def step(self, actions: np.ndarray) -> Any:
        observations, *rest = self.env.step(actions)
        return {"x": 2.0 * observations["x"]}, *rest


def test_a_wrapped_vector_says_what_the_vector_says(ours: StairSb3VecEnv) -> None:
    vector = WorkerVectorEnv([make_walk] * 3, autoreset_mode="SameStep", workers=1, context="fork", copy=False)
    wrapped = WrappedSb3VecEnv(Doubled(vector))
    for venv in (ours, wrapped):
        venv.seed(5)
        venv.set_options({"x": 0.5})
    np.testing.assert_array_equal(wrapped.reset()["x"], 2.0 * ours.reset()["x"])
    rng, ends = np.random.default_rng(0), 0
    for _ in range(40):
        actions = rng.uniform(-0.6, 0.6, (3, 1)).astype(np.float32)
        (x, rewards, dones, infos), wanted = wrapped.step(actions), ours.step(actions)
        np.testing.assert_array_equal(x["x"], 2.0 * wanted[0]["x"])
        np.testing.assert_array_equal(rewards, wanted[1])
        np.testing.assert_array_equal(dones, wanted[2])
        assert infos == wanted[3] and wrapped.reset_infos == ours.reset_infos
        ends += int(dones.sum())
    assert ends and wrapped.env_is_wrapped(CurriculumAccess) == [True] * 3
    wrapped.set_options([{"x": 0.1}, {"x": 0.2}, {"x": 0.1}])
    with pytest.raises(ValueError, match="must be the same for every environment"):
        wrapped.reset()
    wrapped.close()


def test_the_cameras_of_all_environments_share_a_batch() -> None:
    """What PPO collects with one network here equals what each environment's own network brings, but for rounding."""
    kwargs = {"camera": {"width": 160}, "num_steps": 3, "max_episode_steps": 7}
    ours = make_vec_env(PERCEPTION_ID, 2, kwargs, seed=4, kind="workers")
    theirs = make_vec_env(PERCEPTION_ID, 2, kwargs, seed=4, kind="dummy")
    assert isinstance(ours.venv, WrappedSb3VecEnv)  # type: ignore[attr-defined]
    assert ours.observation_space == theirs.observation_space
    first, wanted = ours.reset(), theirs.reset()
    np.testing.assert_array_equal(first["proprio"], wanted["proprio"])
    np.testing.assert_allclose(first["stair"], wanted["stair"], atol=1e-3)
    for _ in range(10):
        actions = np.zeros((2, 16), np.float32)
        (observation, _, dones, infos), (expected, _, ends, theirs_infos) = ours.step(actions), theirs.step(actions)
        np.testing.assert_allclose(observation["stair"], expected["stair"], atol=1e-3)
        np.testing.assert_array_equal(dones, ends)
        for mine, yours in zip(infos, theirs_infos):
            assert ("terminal_observation" in mine) == ("terminal_observation" in yours)
            assert mine["camera"] == yours["camera"] and mine.keys() == yours.keys()
    ours.close(), theirs.close()


def test_curriculum_goes_through(ours: StairSb3VecEnv) -> None:
    ours.reset()
    states = [{"level": level, "results": [True]} for level in (1, 2, 3)]
    restore_curriculum(ours, states)
    assert curriculum_states(ours) == states
    assert ours.env_method("get_curriculum_state", indices=[2, 0]) == [states[2], states[0]]


def test_attributes(ours: StairSb3VecEnv) -> None:
    ours.reset()
    ours.set_attr("x", 0.25, indices=1)
    assert ours.get_attr("x") == [0.0, 0.25, 0.0] and ours.get_attr("x", indices=[1]) == [0.25]
    assert ours.has_attr("get_curriculum_state") and not ours.has_attr("compute_reward")
    with pytest.raises(AttributeError):
        ours.get_attr("nothing")
    assert ours.env_is_wrapped(CurriculumAccess) == [True] * 3 and ours.env_is_wrapped(Monitor) == [False] * 3


def test_the_autoreset_mode_must_be_sb3s() -> None:
    vector = WorkerVectorEnv([make_walk], context="fork")
    with pytest.raises(ValueError, match="autoreset_mode='NextStep' must be 'SameStep'"):
        StairSb3VecEnv(vector)
    vector.close()


def test_ppo_learns_in_climbing_workers() -> None:
    venv = make_vec_env(CLIMB_ID, 2, {"max_episode_steps": 6, "curriculum": True}, seed=1, kind="workers")
    assert isinstance(venv, VecMonitor)
    model = PPO("MultiInputPolicy", venv, n_steps=8, batch_size=8, n_epochs=1, device="cpu").learn(16)
    assert model.ep_info_buffer and model.ep_info_buffer[0]["l"] == 6
    assert len(curriculum_states(venv) or ()) == 2
    venv.close()
