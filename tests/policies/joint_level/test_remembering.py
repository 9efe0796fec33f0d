"""Policies that remember act the same with the wrapper and without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from policies import pretrained
from policies.make_env import CLIMB_ID, make_env, make_vec_env
from policies.train.imitation.dagger import ImitationConfig, imitate
from stair_env.common.validation import SpecError
from stair_env.onboard.memory import MEMORY_KEY

JOINT = {"actuation": "joint", "direction": "both"}


@pytest.fixture(scope="module")
def student(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("student")
    config = ImitationConfig(
        JOINT, rounds=1, steps_per_round=64, num_envs=2, updates=5, batch_size=32, net_arch=(16,), vec_kind="dummy"
    )
    imitate(config, folder)
    return folder / "final"


def test_a_policy_brings_its_memory(student: Path) -> None:
    bare, remembering = make_env(CLIMB_ID, JOINT, monitor=False), make_env(CLIMB_ID, {**JOINT, "memory": True})
    policy = pretrained.load(student, bare)
    pretrained.load(student, remembering)
    (seen, _), (known, _) = bare.reset(seed=1), remembering.reset(seed=1)
    state = None
    for step in range(30):
        action, state = policy.predict(seen, state, np.array([step == 0]))
        expected, _ = policy.predict(known)
        assert np.array_equal(action, expected)
        seen, known = bare.step(action)[0], remembering.step(action)[0]
    bare.close()
    remembering.close()


def test_a_batch_is_remembered_row_by_row(student: Path) -> None:
    venv = make_vec_env(CLIMB_ID, 2, {**JOINT, "memory": True, "max_episode_steps": 12}, kind="dummy")
    policy = pretrained.load(student)
    known, state, starts = venv.reset(), None, np.ones(2, bool)
    for _ in range(30):  # episodes end on the way
        seen = {key: value for key, value in known.items() if key != MEMORY_KEY}
        action, state = policy.predict(seen, state, starts)
        assert np.array_equal(action, policy.predict(known)[0])
        known, _, starts, _ = venv.step(action)
    venv.close()


def test_only_joint_level_environments_remember() -> None:
    with pytest.raises(SpecError, match='actuation="joint"'):
        make_env(CLIMB_ID, {"memory": True})


def test_the_shipped_student_walks_towards_the_stairs() -> None:
    """Without gait, clock and wrapper: two seconds of walking, upright, before the first step."""
    env = make_env(CLIMB_ID, {**pretrained.interface("aliengo-joint"), "direction": "up"}, monitor=False)
    policy = pretrained.load("aliengo-joint", env)
    observation, info = env.reset(seed=0, options={"x": -1.5, "y": 0.0, "yaw": 0.0})
    start, state = info["truth"]["position"][0], None
    for _ in range(96):
        action, state = policy.predict(observation, state)
        observation, _, terminated, _, info = env.step(action)
        assert not terminated
    assert info["truth"]["position"][0] > start + 0.3
    env.close()
