"""Learning from the gait: what is learned fits the advice, and a killed run goes on where it was."""

from __future__ import annotations

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from policies import pretrained
from policies.make_env import CLIMB_ID, make_env
from policies.train.imitation.dagger import ImitationConfig, imitate
from stair_env.observation import STAIR_FIELDS

CONFIG = ImitationConfig(
    {"actuation": "joint", "direction": "both"},
    rounds=3,
    steps_per_round=96,
    num_envs=2,
    updates=20,
    batch_size=64,
    net_arch=(32,),
    handover_rounds=1,
    vec_kind="dummy",
)


def test_the_student_comes_nearer_to_the_teacher(tmp_path: Path) -> None:
    card = imitate(CONFIG, tmp_path)
    with (tmp_path / "curve.csv").open() as file:
        losses = [float(row["loss"]) for row in csv.DictReader(file)]
    assert len(losses) == 3 and losses[-1] < losses[0]
    assert card["timesteps"] == 3 * 96 and card["env_kwargs"]["memory"]
    env = make_env(CLIMB_ID, CONFIG.env_kwargs)
    policy = pretrained.load(tmp_path / "final", env)
    action, _ = policy.predict(env.reset(seed=0)[0])
    assert env.action_space.contains(action)
    env.close()


def test_age_and_confidence_do_not_matter_to_who_learned_on_the_truth(tmp_path: Path) -> None:
    """A camera's block is older and less sure than any that was seen in learning."""
    card = imitate(CONFIG, tmp_path)
    assert card["symmetric"]
    policy = pretrained.load(tmp_path / "final")
    env = make_env(CLIMB_ID, {**CONFIG.env_kwargs, "memory": True})
    seen = env.reset(seed=1)[0]
    env.close()
    assert seen["stair"][0] == 1.0

    def act(**changes: float) -> np.ndarray:
        stair = seen["stair"].copy()
        for name, value in changes.items():
            stair[STAIR_FIELDS.index(name)] = value
        return policy.predict({**seen, "stair": stair})[0]

    assert act(age=1.5, confidence=0.2) == pytest.approx(act(), abs=1e-6)
    assert not np.allclose(act(edge_distance=0.1), act(), atol=1e-4)


def test_a_killed_run_goes_on_as_if_nothing_had_happened(tmp_path: Path) -> None:
    def stop(row: dict[str, object]) -> None:
        if row["round"] == 1:
            raise KeyboardInterrupt

    whole, parts = tmp_path / "whole", tmp_path / "parts"
    imitate(CONFIG, whole)
    with pytest.raises(KeyboardInterrupt):
        imitate(CONFIG, parts, on_round=stop)
    with pytest.raises(ValueError, match="already holds a run"):
        imitate(CONFIG, parts)
    imitate(CONFIG, parts, resume=True)
    for name in ("round_001.npz", "round_002.npz"):
        one, other = np.load(whole / "rounds" / name), np.load(parts / "rounds" / name)
        assert all(np.array_equal(one[key], other[key]) for key in one.files)
    card = json.loads((parts / "final" / "card.json").read_text())
    assert card["timesteps"] == 3 * 96


def test_wrong_values_are_named() -> None:
    with pytest.raises(ValueError, match="rounds=0"):
        dataclasses.replace(CONFIG, rounds=0)
