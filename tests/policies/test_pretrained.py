"""Shipped policies: loaded by name, checked before they are unpickled, refused where they do not fit."""

from __future__ import annotations

import json
import pickle
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from policies import pretrained
from policies.make_env import make_env, make_vec_env, normalise
from policies.pretrained import PolicyError
from policies.train import checkpoints
from policies.train.training import TrainingConfig, algorithm_class, train


@pytest.fixture()
def run_folder(toy_id: str, tmp_path: Path) -> Path:
    """A policy as a run's `final/` holds it, with statistics that matter."""
    venv = normalise(make_vec_env(toy_id, 2, kind="dummy"), gamma=0.99)
    model = algorithm_class("ppo")(
        "MultiInputPolicy", venv, n_steps=64, batch_size=64, n_epochs=1, seed=1, device="cpu"
    )
    model.learn(128)
    folder = tmp_path / "run" / "final"
    checkpoints.save_policy(model, folder)
    (folder / "card.json").write_text(json.dumps({"algorithm": "ppo", "timesteps": 128}))
    return folder


@pytest.fixture()
def weights(run_folder: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "weights"
    pretrained.add(run_folder, "toy", folder)
    return folder


def test_named_policy_acts_like_the_trained_one(weights: Path, run_folder: Path, toy_id: str) -> None:
    env = make_env(toy_id)
    policy = pretrained.load("toy", env, weights)
    assert policy.card["timesteps"] == 128
    observation, _ = env.reset(seed=0)
    action, state = policy.predict(observation)
    assert state is None and env.action_space.contains(action)

    model = algorithm_class("ppo").load(run_folder / "model.zip")
    statistics = pickle.loads((run_folder / "vecnormalize.pkl").read_bytes())
    expected, _ = model.predict(statistics.normalize_obs(observation), deterministic=True)
    unnormalised, _ = model.predict(observation, deterministic=True)
    assert np.array_equal(action, expected) and not np.array_equal(action, unnormalised)


def test_model_card_tells_training_and_evaluation(run_folder: Path, tmp_path: Path) -> None:
    (run_folder.parent / "config.json").write_text("{}")
    (run_folder.parent / "curve.csv").write_text("timesteps,success_rate,level_mean\n100,0.5,1.0\n200,0.75,2.0\n")
    overall = {"oracle": {"episodes": 50, "success_rate": 0.94, "ci95": [0.84, 0.98]}}
    evaluation = tmp_path / "evaluate.json"
    evaluation.write_text(json.dumps({"overall": overall, "robot": "aliengo", "stairs": "paper", "lighting": "day"}))
    folder = pretrained.add(run_folder, "toy", tmp_path / "weights", [evaluation])
    text = (folder / "README.md").read_text()
    assert "environment steps: 128" in text and "| oracle | 50 | 0.94 | 0.84, 0.98 |" in text
    assert "curve.png" in text and (folder / "curve.png").is_file()


def test_a_checkpoint_gets_its_card_from_the_run(toy_id: str, tmp_path: Path) -> None:
    file = tmp_path / "ppo.yml"
    values = {"n_timesteps": 128, "n_envs": 1, "policy": "MultiInputPolicy", "n_steps": 64, "batch_size": 64}
    file.write_text(json.dumps({toy_id: values}))
    config = TrainingConfig(
        env_id=toy_id, hyperparams_file=str(file), vec_kind="dummy", checkpoint_every=64, env_kwargs={"size": 5}
    )
    train(config, tmp_path / "run")
    folder = pretrained.add(tmp_path / "run" / "checkpoints" / "step_000000064", "early", tmp_path / "weights")
    card = json.loads((folder / "card.json").read_text())
    assert (card["timesteps"], card["env_kwargs"], card["algorithm"]) == (64, {"size": 5}, "ppo")
    assert pretrained.load("early", make_env(toy_id, {"size": 5}), tmp_path / "weights").card == card


@pytest.mark.parametrize("named", ["folder", "zip"])
def test_an_rl_zoo3_run_loads_with_its_statistics(run_folder: Path, tmp_path: Path, toy_id: str, named: str) -> None:
    run = tmp_path / "logs" / "ppo" / "Toy-v0_1"
    (run / "Toy-v0").mkdir(parents=True)
    (run_folder / "model.zip").rename(run / "Toy-v0.zip")
    (run_folder / "vecnormalize.pkl").rename(run / "Toy-v0" / "vecnormalize.pkl")
    path = run if named == "folder" else run / "Toy-v0.zip"
    assert pretrained.locate(path) == run
    observation, _ = make_env(toy_id).reset(seed=0)
    pretrained.add(path, "zoo", tmp_path / "weights")
    actions = [
        p.predict(observation)[0] for p in (pretrained.load(path), pretrained.load("zoo", None, tmp_path / "weights"))
    ]
    plain, _ = algorithm_class("ppo").load(run / "Toy-v0.zip").predict(observation, deterministic=True)
    assert np.array_equal(*actions) and not np.array_equal(actions[0], plain)


def test_batches_and_single_observations_agree(weights: Path, toy_id: str) -> None:
    env = make_env(toy_id)
    policy = pretrained.load("toy", env, weights)
    observations = [env.reset(seed=seed)[0] for seed in range(3)]
    batch = {key: np.stack([observation[key] for observation in observations]) for key in observations[0]}
    together, _ = policy.predict(batch)
    single = np.stack([policy.predict(observation)[0] for observation in observations])
    assert np.allclose(together, single, atol=1e-6)


@pytest.mark.parametrize("file", ["model.zip", "vecnormalize.pkl"])
def test_changed_file_is_never_unpickled(file: str, weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = weights / "toy" / file
    path.write_bytes(path.read_bytes() + b"x")
    monkeypatch.setattr(pretrained, "_rebuild", lambda *args: pytest.fail("unpickled a changed file"))
    with pytest.raises(PolicyError, match=f"{file} has SHA-256"):
        pretrained.load("toy", weights=weights)


def test_missing_file_is_named(weights: Path) -> None:
    (weights / "toy" / "model.zip").unlink()
    with pytest.raises(PolicyError, match=r"model.zip is missing"):
        pretrained.load("toy", weights=weights)


def test_unknown_name_lists_the_choices(weights: Path) -> None:
    with pytest.raises(PolicyError, match=r"'tyo'.*\(toy\)"):
        pretrained.load("tyo", weights=weights)


def test_a_folder_or_a_zip_of_ones_own_is_loaded(run_folder: Path, weights: Path) -> None:
    for path in (run_folder, run_folder / "model.zip"):
        assert pretrained.load(path, weights=weights).card["timesteps"] == 128


def test_a_file_that_is_no_model_is_named(tmp_path: Path) -> None:
    (tmp_path / "model.zip").write_bytes(b"no zip at all")
    with pytest.raises(PolicyError, match="no Stable-Baselines3 model"):
        pretrained.load(tmp_path)


def test_other_spaces_are_refused(weights: Path, toy_id: str) -> None:
    with pytest.raises(PolicyError, match=r"observation_space \['proprio'\].*\(4,\).*\(3,\)"):
        pretrained.load("toy", make_env(toy_id, {"size": 4}), weights)


def test_every_shipped_policy_loads() -> None:
    for name in pretrained.names():
        assert pretrained.load(name).card["env_id"]


def write_policy(folder: Path, **card: Any) -> Path:
    folder.mkdir(parents=True)
    (folder / "model.zip").write_bytes(b"")
    (folder / "card.json").write_text(json.dumps(card))
    return folder


def test_a_policy_tells_the_arguments_without_which_it_does_not_fit(tmp_path: Path) -> None:
    env_kwargs = {"actuation": "joint", "curriculum": True, "riser_height": [0.1, 0.2]}
    folder = write_policy(tmp_path / "own", env_id="stair_env/StairClimb-v0", env_kwargs=env_kwargs)
    assert pretrained.interface(folder) == {"robot": "aliengo", "actuation": "joint"}
    assert pretrained.interface(write_policy(tmp_path / "foreign", env_id="CartPole-v1")) == {}
    assert pretrained.interface("no such policy") == pretrained.interface("zero") == {}


def test_robots_and_policies_go_together(tmp_path: Path) -> None:
    folder = write_policy(tmp_path / "own", env_id="stair_env/StairClimb-v0", env_kwargs={"robot": "laikago"})
    assert pretrained.fitting_robot(None, [folder]) == "laikago"
    assert pretrained.fitting_robot(None, [None, "random"]) == "aliengo"
    assert pretrained.fitting_robot("a1", ["a1", None]) == "a1"
    with pytest.raises(PolicyError, match=r"robot='a1': policy '.*own' was trained on 'laikago'.* of 'a1': a1"):
        pretrained.fitting_robot("a1", [folder])
    with pytest.raises(ValueError, match="robot='cat'"):
        pretrained.fitting_robot("cat", ["a1"])


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff"])
def test_a_damaged_card_is_named(content: bytes, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    shutil.copytree(pretrained.WEIGHTS_FOLDER / "a1", folder)
    (folder / "card.json").write_bytes(content)
    with pytest.raises(PolicyError, match=r"card.json"):
        pretrained.load(folder)
