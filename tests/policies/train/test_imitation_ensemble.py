"""Several networks in one: what it returns is the mean of what they return."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from policies import pretrained
from policies.make_env import CLIMB_ID, make_env
from policies.train.imitation import dagger
from policies.train.imitation.ensemble import fit_ensemble, merge_actors

CONFIG = dagger.ImitationConfig(
    {"actuation": "joint", "direction": "both"},
    rounds=1,
    steps_per_round=64,
    num_envs=2,
    updates=10,
    batch_size=32,
    net_arch=(16, 8),
    vec_kind="dummy",
)


def test_the_merged_actor_returns_the_mean() -> None:
    venv = dagger.make_students_env(CONFIG, 1)
    members = [dagger.new_model(CONFIG, venv) for _ in range(3)]
    for seed, member in enumerate(members):
        for parameter in member.policy.parameters():
            parameter.data = parameter.data + 0.02 * np.random.default_rng(seed).normal()
    merged = dagger.new_model(dataclasses.replace(CONFIG, net_arch=(48, 24)), venv)
    merge_actors(members, merged)
    venv.reset()
    seen = venv.observation_space.sample()
    one, *others = (model.policy.predict(seen, deterministic=True)[0] for model in (merged, *members))
    assert np.abs(others).max() < 1.0  # nothing is clipped
    assert np.allclose(one, np.mean(others, axis=0), atol=1e-4)
    venv.close()


def test_an_ensemble_is_an_ordinary_policy(tmp_path: Path) -> None:
    dagger.imitate(CONFIG, tmp_path / "run")
    losses: list[float] = []
    fit_ensemble(tmp_path / "run", tmp_path / "mean", 2, 5, on_member=lambda _, loss: losses.append(loss))
    assert len(losses) == 2 and losses[0] != losses[1]
    card = json.loads((tmp_path / "mean" / "card.json").read_text())
    assert card["hyperparams"]["net_arch"] == [32, 16] and card["hyperparams"]["members"] == 2
    env = make_env(CLIMB_ID, CONFIG.env_kwargs)
    policies = [pretrained.load(tmp_path / name, env) for name in ("run/final", "mean")]
    seen = env.reset(seed=0)[0]
    actions = [policy.predict(seen)[0] for policy in policies]
    assert actions[0].shape == actions[1].shape == (12,) and not np.array_equal(*actions)
    env.close()


def test_wrong_numbers_are_named(tmp_path: Path) -> None:
    dagger.imitate(CONFIG, tmp_path)
    with pytest.raises(ValueError, match="members=0"):
        fit_ensemble(tmp_path, tmp_path / "mean", 0)
