"""Training: a run learns, is resumable after a kill, and leaves whole files."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from policies.hyperparams import ALGORITHMS, load_hyperparams
from policies.make_env import ENV_IDS, make_env, make_vec_env, normalise
from policies.train import checkpoints, training
from policies.train.curves import read_curve
from stair_env.observation import NO_STAIRS
from stair_env.parts import RewardTerm
from stair_env.robots import get_robot

PPO = {"n_steps": 64, "batch_size": 64, "n_epochs": 2, "policy": "policies.features.StairActorCriticPolicy"}
SAC = {"learning_starts": 50, "policy": "policies.features.StairSacPolicy", "buffer_size": 2000}
NORMALISE = {"normalize": {"norm_obs_keys": ["proprio"]}}


def toy_config(toy_id: str, tmp_path: Path, algorithm: str = "ppo", steps: int = 256, **other: Any) -> Any:
    values = {**(PPO if algorithm == "ppo" else SAC), **NORMALISE}
    file = tmp_path / f"{algorithm}.yml"
    file.write_text(json.dumps({toy_id: {"n_timesteps": 10, "n_envs": 2, **values}}))  # JSON is YAML
    return training.TrainingConfig(
        algorithm=algorithm,
        env_id=toy_id,
        hyperparams_file=str(file),
        total_timesteps=steps,
        vec_kind="dummy",
        checkpoint_every=128,
        **other,
    )


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_run_leaves_policy_card_and_curve(algorithm: str, toy_id: str, tmp_path: Path) -> None:
    card = training.train(toy_config(toy_id, tmp_path, algorithm), tmp_path / "run")
    final = tmp_path / "run" / "final"
    assert {path.name for path in final.iterdir()} == {"model.zip", "vecnormalize.pkl", "card.json"}
    assert card["timesteps"] == 256 and json.loads((final / "card.json").read_text())["timesteps"] == 256
    rows = read_curve(tmp_path / "run" / "curve.csv")
    assert rows[-1]["timesteps"] == 256 and rows[-1]["episodes"] > 20
    assert card["curriculum"] == [{"level": 12, "results": []}] * 2


def test_ppo_learns_the_toy(toy_id: str, tmp_path: Path) -> None:
    config = toy_config(toy_id, tmp_path, steps=6000, hyperparams={"n_epochs": 10, "learning_rate": 3e-3, "gamma": 0.0})
    card = training.train(config, tmp_path / "run")
    assert card["training"]["return_mean"] > -3.0  # a constant action earns -5


class Kill(Exception):
    pass


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_killed_run_resumes_from_its_last_checkpoint(
    algorithm: str, toy_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = toy_config(toy_id, tmp_path, algorithm, steps=512)
    saved: list[Path] = []
    save = checkpoints.save_policy

    def save_then_die(model: Any, folder: Path) -> None:
        save(model, folder)
        saved.append(folder)
        if len(saved) == 2:
            raise Kill  # in the middle of writing the second checkpoint

    monkeypatch.setattr(checkpoints, "save_policy", save_then_die)
    with pytest.raises(Kill):
        training.train(config, tmp_path / "run")
    left = checkpoints.list_checkpoints(tmp_path / "run" / "checkpoints")
    assert [checkpoints.read_state(path)["num_timesteps"] for path in left] == [128]
    assert checkpoints.read_state(left[0])["curriculum"] == [{"level": 6, "results": []}] * 2

    monkeypatch.setattr(checkpoints, "save_policy", save)
    card = training.train(config, tmp_path / "run", resume=True)
    assert card["timesteps"] == 512
    # 64 steps before the checkpoint make 6 whole episodes; the 192 after it 19: nothing was counted twice or lost.
    assert card["curriculum"] == [{"level": 25, "results": []}] * 2
    steps = [row["timesteps"] for row in read_curve(tmp_path / "run" / "curve.csv")]
    assert steps == sorted(set(steps)) and steps[-1] == 512


def test_resume_keeps_weights_statistics_and_random_state(toy_id: str, tmp_path: Path) -> None:
    import torch

    config = toy_config(toy_id, tmp_path)
    venv = normalise(make_vec_env(toy_id, 2, kind="dummy"), gamma=0.99)
    model = training.algorithm_class("ppo")(
        "MultiInputPolicy", venv, n_steps=64, batch_size=64, seed=1, device="cpu"
    ).learn(128)
    folder = checkpoints.save_checkpoint(model, tmp_path / "checkpoints")
    drawn = torch.rand(3), np.random.rand(3)  # noqa: NPY002

    fresh = make_vec_env(toy_id, 2, kind="dummy")
    loaded = training._load_model(config, config.resolved_hyperparams(), fresh, folder)
    assert torch.equal(torch.rand(3), drawn[0]) and np.array_equal(np.random.rand(3), drawn[1])  # noqa: NPY002
    for name, value in model.policy.state_dict().items():
        assert torch.equal(loaded.policy.state_dict()[name], value)
    statistics = loaded.get_vec_normalize_env().obs_rms
    assert list(statistics) == ["proprio"]
    assert np.array_equal(statistics["proprio"].mean, venv.obs_rms["proprio"].mean)
    assert fresh.env_method("get_curriculum_state") == venv.env_method("get_curriculum_state")


@pytest.mark.parametrize("file", ["model.zip", "vecnormalize.pkl", "state.json", "random.pkl"])
def test_a_damaged_checkpoint_is_named(file: str, toy_id: str, tmp_path: Path) -> None:
    config = toy_config(toy_id, tmp_path)
    training.train(config, tmp_path / "run")
    newest = checkpoints.list_checkpoints(tmp_path / "run" / "checkpoints")[-1]
    content = (newest / file).read_bytes()
    (newest / file).write_bytes(content[: len(content) // 2])
    longer = dataclasses.replace(config, total_timesteps=512)
    with pytest.raises(ValueError, match=rf"{newest.name}: damaged or cut short"):
        training.train(longer, tmp_path / "run", resume=True)


def test_a_damaged_run_is_named(toy_id: str, tmp_path: Path) -> None:
    for content, says in (("{", "cut short"), ("[1]", "must hold a JSON object")):
        (tmp_path / training.CONFIG_FILE).write_text(content)
        with pytest.raises(ValueError, match=f"{training.CONFIG_FILE}: .*{says}"):
            training.load_config(tmp_path)


def test_only_the_newest_checkpoints_stay(toy_id: str, tmp_path: Path) -> None:
    training.train(toy_config(toy_id, tmp_path, steps=640), tmp_path / "run")
    names = [path.name for path in (tmp_path / "run" / "checkpoints").iterdir()]
    assert sorted(names) == ["step_000000512", "step_000000640"]


def test_fine_tuning_starts_from_the_given_policy(toy_id: str, tmp_path: Path) -> None:
    import torch

    training.train(toy_config(toy_id, tmp_path), tmp_path / "first")
    config = toy_config(toy_id, tmp_path, seed=5, hyperparams={"learning_rate": 0.0})
    training.train(config, tmp_path / "second", start_from=tmp_path / "first" / "final")
    load = training.algorithm_class("ppo").load
    first, second = (load(tmp_path / run / "final" / "model.zip").policy.state_dict() for run in ("first", "second"))
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_a_folder_in_use_is_refused(toy_id: str, tmp_path: Path) -> None:
    training.train(toy_config(toy_id, tmp_path), tmp_path / "run")
    with pytest.raises(ValueError, match="already holds a run"):
        training.train(toy_config(toy_id, tmp_path), tmp_path / "run")


def test_a_refused_run_leaves_no_folder(toy_id: str, tmp_path: Path) -> None:
    config = toy_config(toy_id, tmp_path, env_kwargs={"direction": "sideways"})
    with pytest.raises(ValueError, match="direction='sideways'"):
        training.train(config, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "wrong", [{"algorithm": "a2c"}, {"total_timesteps": 0}, {"num_envs": 0}, {"checkpoint_every": -1}]
)
def test_wrong_configuration_is_named(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        training.TrainingConfig(**wrong)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("env_id", ENV_IDS)
def test_shipped_hyperparameters_are_accepted_by_sb3(algorithm: str, env_id: str, toy_id: str) -> None:
    values = load_hyperparams(algorithm, env_id)
    assert values["n_timesteps"] <= 3_000_000
    arguments, normalisation = training._split(values)
    assert normalisation["norm_obs_keys"] == ["proprio"]
    venv = make_vec_env(toy_id, values["n_envs"], kind="dummy")
    model = training.algorithm_class(algorithm)(
        env=venv, device="cpu", **{**arguments, "buffer_size": 10} if algorithm == "sac" else arguments
    )
    assert (
        type(model.policy.features_extractor if algorithm == "ppo" else model.actor.features_extractor).__name__
        == "StairFeatures"
    )


def test_a_file_may_hold_arguments_of_the_environment(toy_id: str, tmp_path: Path) -> None:
    file = tmp_path / "own.yml"
    file.write_text(json.dumps({toy_id: {"n_timesteps": 10, "env_kwargs": {"size": 5, "level": 1}}}))
    config = training.TrainingConfig(env_id=toy_id, hyperparams_file=str(file), env_kwargs={"size": 7})
    assert config.resolved_env_kwargs() == {"size": 7, "level": 1}
    assert "env_kwargs" not in training._split(config.resolved_hyperparams())[0]


def test_the_file_for_joints_builds_an_environment_without_a_gait() -> None:
    file = Path(load_hyperparams.__code__.co_filename).with_name("ppo_joint.yml")
    config = training.TrainingConfig(hyperparams_file=str(file), env_kwargs={"direction": "both", "curriculum": True})
    env = make_env(config.env_id, json.loads(json.dumps(config.resolved_env_kwargs())))
    assert env.action_space.shape == (12,) and "command" in env.observation_space.spaces
    weights = {name: term.weight for name, term in env.unwrapped.rewards.terms.items()}
    assert weights["track_velocity"] == 1.0 and "action_size" not in weights
    env.close()


def test_missing_hyperparameters_name_what_there_is(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="stair_env/StairClimb-v0"):
        load_hyperparams("ppo", "Other-v0")
    with pytest.raises(ValueError, match="ppo, sac"):
        load_hyperparams("dqn", "stair_env/StairClimb-v0")
    (tmp_path / "bad.yml").write_text("a: [")
    with pytest.raises(ValueError, match="not YAML"):
        load_hyperparams("ppo", "stair_env/StairClimb-v0", tmp_path / "bad.yml")


def test_linear_schedule_falls_to_zero() -> None:
    schedule = training._schedule("lin_0.001")
    assert schedule(1.0) == pytest.approx(0.001) and schedule(0.0) == pytest.approx(0.0)
    with pytest.raises(ValueError, match="lin_NUMBER"):
        training._schedule("cos_1")


class Flat:
    """A stair source of one's own: no stairs."""

    def reset(self, spec: Any, rng: np.random.Generator) -> None:
        pass

    def read(self, pose: Any, truth: Any) -> Any:
        return NO_STAIRS


def torque(state: Any) -> float:
    return -float(np.square(state.joint_torques).sum())


def test_parts_may_be_objects(tmp_path: Path) -> None:
    parts = {
        "robot": dataclasses.replace(get_robot("a1"), name="my_a1"),
        "stair_source": Flat(),
        "rewards": {"torque": RewardTerm(torque, 1e-4), "nosing": None},
        "max_episode_steps": 40,
    }
    config = training.TrainingConfig(
        env_kwargs=parts,
        hyperparams={"n_steps": 32, "batch_size": 32, "n_epochs": 1},
        total_timesteps=32,
        num_envs=1,
        vec_kind="dummy",
        checkpoint_every=32,
    )
    card = training.train(config, tmp_path / "run")
    saved = json.loads((tmp_path / "run" / "config.json").read_text())["env_kwargs"]
    assert saved == card["env_kwargs"] and saved["robot"]["name"] == "my_a1" and saved["rewards"]["nosing"] is None
    assert saved["rewards"]["torque"]["fn"]["object"].endswith("torque") and saved["stair_source"]["object"].endswith(
        "Flat"
    )
    with pytest.raises(ValueError, match=r"parts that are objects.*Flat.*resume=True"):
        training.load_config(tmp_path / "run")
    longer = dataclasses.replace(config, total_timesteps=64)
    assert training.train(longer, tmp_path / "run", resume=True)["timesteps"] == 64
