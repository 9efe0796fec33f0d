"""Environments for Stable-Baselines3."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.monitor import Monitor

from policies.make_env import CLIMB_ID, CurriculumAccess, make_env, make_vec_env, normalise

SHORT = {"max_episode_steps": 12}


def test_curriculum_is_reachable_through_the_wrappers() -> None:
    env = make_env(CLIMB_ID, {"curriculum": True})
    assert isinstance(env, Monitor)
    env.get_wrapper_attr("set_curriculum_state")({"level": 3, "results": [True]})
    assert env.unwrapped.curriculum.level == 3  # type: ignore[attr-defined]
    assert env.get_wrapper_attr("get_curriculum_state")() == {"level": 3, "results": [True]}
    env.close()


def test_without_a_curriculum_there_is_no_state() -> None:
    env = CurriculumAccess(gym.make(CLIMB_ID))
    assert env.get_curriculum_state() is None
    env.set_curriculum_state({"level": 3, "results": []})
    env.close()


def rollout(kind: str) -> list[np.ndarray]:
    venv = make_vec_env(CLIMB_ID, 2, {"direction": "both", **SHORT}, seed=3, kind=kind)
    seen = [venv.reset()["proprio"]]
    rng = np.random.default_rng(0)
    for _ in range(30):
        seen.append(venv.step(rng.uniform(-1, 1, (2, 16)).astype(np.float32))[0]["proprio"])
    venv.close()
    return seen


@pytest.mark.parametrize("kind", ["subproc", "workers"])
def test_processes_and_one_process_see_the_same(kind: str) -> None:
    one, many = rollout("dummy"), rollout(kind)
    assert all(np.array_equal(a, b) for a, b in zip(one, many, strict=True))
    assert not np.array_equal(one[0][0], one[0][1])


def test_only_the_proprioception_is_normalised() -> None:
    venv = normalise(make_vec_env(CLIMB_ID, 1, SHORT, kind="dummy"), gamma=0.9)
    assert venv.norm_obs_keys == ["proprio"] and venv.gamma == 0.9
    venv.close()


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"kind": "threads"}, "kind='threads'.*auto, subproc, dummy"),
        ({"num_envs": 0}, "num_envs=0"),
        ({"env_kwargs": {"robot": "cat"}}, "robot='cat'.*aliengo"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        make_vec_env(**{"env_id": CLIMB_ID, "num_envs": 1, **arguments})
