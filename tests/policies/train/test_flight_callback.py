"""Flights during a training: they are written, and the training does not notice them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perception.sources.source import MissingExtraError
from policies.train import training

PPO = {"n_steps": 32, "batch_size": 32, "n_epochs": 1, "n_envs": 1}
STAIRS = {"direction": "both", "riser_height": 0.1, "num_steps": 1, "curriculum": True}


def config(**other: Any) -> training.TrainingConfig:
    return training.TrainingConfig(
        env_kwargs=STAIRS, hyperparams=PPO, total_timesteps=64, vec_kind="dummy", checkpoint_every=32, **other
    )


def test_flights_are_written_and_change_nothing(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="recordings for Rerun need the extra stair-env[rerun]")
    from stable_baselines3 import PPO as Algorithm

    training.train(config(), tmp_path / "plain")
    training.train(config(rerun=True), tmp_path / "watched")
    names = [path.name for path in sorted((tmp_path / "watched" / "flights").iterdir())]
    assert names == ["steps_000000032.rrd", "steps_000000064.rrd"]
    data = (tmp_path / "watched" / "flights" / names[0]).read_bytes()
    assert all(name in data for name in (b"world/true", b"world/robot", b"reward/"))
    plain, watched = (
        Algorithm.load(tmp_path / name / "final" / "model.zip", device="cpu").get_parameters()["policy"]
        for name in ("plain", "watched")
    )
    for key in plain:
        np.testing.assert_array_equal(plain[key].numpy(), watched[key].numpy(), err_msg=key)


def test_without_the_library_nothing_begins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match=r"stair-env\[rerun\]"):
        training.train(config(rerun=True), tmp_path / "run")
    assert not (tmp_path / "run").exists()
