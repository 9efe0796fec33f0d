"""Saved policies of every algorithm are rebuilt as they acted, and no file, whatever is in it, runs anything."""

from __future__ import annotations

import base64
import copy
import io
import json
import os
import pickle
import zipfile
from pathlib import Path
from typing import Any

import cloudpickle
import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3

from policies import pretrained
from policies.features import StairSacPolicy, StairTd3Policy
from policies.make_env import make_env
from policies.pretrained import PolicyError
from policies.saved_models import SavedModelError, algorithm_in_arguments, read_model, read_pickle

SMALL = {"net_arch": [8]}
OFF_POLICY = {"buffer_size": 100, "policy_kwargs": SMALL}
MODELS: dict[str, tuple[Any, Any, dict[str, Any]]] = {
    "ppo": (PPO, "MultiInputPolicy", {"n_steps": 8, "batch_size": 8, "policy_kwargs": SMALL}),
    "a2c": (A2C, "MultiInputPolicy", {"policy_kwargs": SMALL}),
    "sac": (SAC, StairSacPolicy, OFF_POLICY),
    "td3": (TD3, StairTd3Policy, OFF_POLICY),
    "ddpg": (DDPG, "MultiInputPolicy", OFF_POLICY),
}
CONTRIB = {
    "tqc": ("TQC", "MultiInputPolicy", OFF_POLICY),
    "crossq": ("CrossQ", "MlpPolicy", OFF_POLICY),
    "trpo": ("TRPO", "MultiInputPolicy", {"n_steps": 8, "batch_size": 8, "policy_kwargs": SMALL}),
    "ppo_lstm": ("RecurrentPPO", "MultiInputLstmPolicy", {"n_steps": 8, "policy_kwargs": {"lstm_hidden_size": 8}}),
}


def make_model(name: str, toy_id: str) -> Any:
    if name in MODELS:
        kind, policy, arguments = MODELS[name]
    else:
        contrib = pytest.importorskip("sb3_contrib")
        kind, policy, arguments = CONTRIB[name]
        kind = getattr(contrib, kind)
    env = make_env(toy_id, monitor=False)
    if policy == "MlpPolicy":
        env = gym.wrappers.FlattenObservation(env)
    return kind(policy, env, seed=0, device="cpu", **copy.deepcopy(arguments))


def flatten_of(env: gym.Env, observation: Any) -> np.ndarray:
    return gym.spaces.flatten(env.observation_space, observation)  # type: ignore[return-value]


def zip_of(model: Any) -> bytes:
    buffer = io.BytesIO()
    model.save(buffer)
    return buffer.getvalue()


@pytest.mark.parametrize("name", [*MODELS, *CONTRIB])
def test_every_algorithm_is_recognised_and_acts_as_it_was_saved(name: str, toy_id: str, tmp_path: Path) -> None:
    model = make_model(name, toy_id)
    model.save(tmp_path / "model.zip")
    env = make_env(toy_id, monitor=False)
    policy = pretrained.load(tmp_path / "model.zip", env)
    assert policy.algorithm == name
    observation, _ = env.reset(seed=1)
    ours = theirs = None
    start = np.array([True])
    for _ in range(5):  # a recurrent policy's memory is handed on
        seen = observation if isinstance(model.observation_space, gym.spaces.Dict) else flatten_of(env, observation)
        expected, theirs = model.predict(seen, theirs, start, deterministic=True)
        action, ours = policy.predict(observation, ours, start)
        assert np.array_equal(action, expected)
        observation, start = env.step(action)[0], np.array([False])


def test_an_algorithm_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    model = DQN("MlpPolicy", "CartPole-v1", buffer_size=100, policy_kwargs=dict(SMALL))
    model.save(tmp_path / "model.zip")
    with pytest.raises(PolicyError, match=r"none of ppo, .*dqn"):
        pretrained.load(tmp_path / "model.zip")


def test_an_rl_zoo3_folder_needs_no_statistics_and_names_its_algorithm(toy_id: str, tmp_path: Path) -> None:
    run = tmp_path / "Toy-v0_1"
    (run / "Toy-v0").mkdir(parents=True)
    arguments = run / "Toy-v0" / "args.yml"
    tag = "!!python/object/apply:collections.OrderedDict"  # as rl_zoo3 writes it
    arguments.write_text(f"{tag}\n- - - algo\n    - sac\n  - - conf\n    - null\n")
    (run / "Toy-v0.zip").write_bytes(zip_of(make_model("sac", toy_id)))
    (run / "best_model.zip").write_bytes(zip_of(make_model("sac", toy_id)))
    for path in (run, run / "best_model.zip"):
        assert pretrained.load(path).algorithm == "sac"
    arguments.write_text("algo: ars\n")
    with pytest.raises(PolicyError, match=r"'ars'.*ppo"):
        pretrained.load(run)


def test_the_arguments_of_a_run_are_not_loaded_as_yaml() -> None:
    text = "!!python/object/apply:os.system ['exit 1']\n- - - algo\n    - tqc\n"
    assert algorithm_in_arguments(text) == "tqc" and algorithm_in_arguments("nothing") is None


class Harm:
    """Makes a folder when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.mark),)


class OwnFeatures(torch.nn.ReLU):
    """A class that stands in a user's script."""


def with_entry(content: bytes, key: str, value: Any) -> bytes:
    """A model's zip with another pickle in its JSON."""
    source, buffer = zipfile.ZipFile(io.BytesIO(content)), io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as target:
        for name in source.namelist():
            text = source.read(name)
            if name == "data":
                data = json.loads(text)
                data[key] = {":type:": "", ":serialized:": base64.b64encode(cloudpickle.dumps(value)).decode()}
                text = json.dumps(data).encode()
            target.writestr(name, text)
    return buffer.getvalue()


@pytest.mark.parametrize("key", ["observation_space", "action_space", "policy_class", "policy_kwargs", "clip_range"])
def test_a_foreign_model_runs_nothing(key: str, toy_id: str, tmp_path: Path) -> None:
    mark = tmp_path / "harmed"
    content = with_entry(zip_of(make_model("ppo", toy_id)), key, Harm(mark))
    if key == "clip_range":  # is not even read
        read_model(content)
    else:
        with pytest.raises(SavedModelError, match=r"mkdir.*trusted"):
            read_model(content)
    assert not mark.exists()


def test_foreign_statistics_and_weights_run_nothing(toy_id: str, tmp_path: Path) -> None:
    mark = tmp_path / "harmed"
    (tmp_path / "model.zip").write_bytes(zip_of(make_model("ppo", toy_id)))
    (tmp_path / "vecnormalize.pkl").write_bytes(pickle.dumps(Harm(mark)))
    with pytest.raises(PolicyError, match=r"vecnormalize.pkl.*mkdir"):
        pretrained.load(tmp_path)
    for harmful in (
        b"cbuiltins\neval\n(S'1'\ntR.",
        b"cstable_baselines3.common.save_util\nload_from_pkl\n(S'x'\ntR.",
        b"cnumpy\nload\n(S'x'\ntR.",
        b"cpolicies.train.checkpoints\nos.system\n(S'x'\ntR.",
    ):
        with pytest.raises(SavedModelError):
            read_pickle(harmful)
    assert not mark.exists()


def test_a_class_of_ones_own_needs_trust(toy_id: str, tmp_path: Path) -> None:
    cloudpickle.register_pickle_by_value(__import__("sys").modules[__name__])
    path = tmp_path / "model.zip"
    kwargs = {"net_arch": [8], "activation_fn": OwnFeatures}
    PPO("MultiInputPolicy", make_env(toy_id), n_steps=8, batch_size=8, policy_kwargs=kwargs).save(path)
    with pytest.raises(PolicyError, match="trusted=True"):
        pretrained.load(path)
    assert pretrained.load(path, trusted=True).algorithm == "ppo"


@pytest.fixture(scope="module")
def shipped() -> bytes:
    return (pretrained.WEIGHTS_FOLDER / "a1" / "model.zip").read_bytes()


@pytest.mark.parametrize("tenth", range(10))
def test_a_zip_that_is_cut_is_told(tenth: int, shipped: bytes) -> None:
    with pytest.raises(SavedModelError):
        read_model(shipped[: len(shipped) * tenth // 10])


@settings(max_examples=40)
@given(st.binary(max_size=200), st.integers(0, 10_000))
def test_statistics_that_are_written_over_are_told_or_read(noise: bytes, at: int) -> None:
    content = (pretrained.WEIGHTS_FOLDER / "a1" / "vecnormalize.pkl").read_bytes()
    at %= len(content)
    try:
        read_pickle(content[:at] + noise + content[at + len(noise) :])
    except SavedModelError as error:
        assert str(error)


def test_spaces_of_shipped_policies_need_no_module_of_one_numpy() -> None:
    for name in pretrained.names():
        for file in ("model.zip", "vecnormalize.pkl"):
            content = (pretrained.WEIGHTS_FOLDER / name / file).read_bytes()
            decoded = content
            if file == "model.zip":
                data = json.loads(zipfile.ZipFile(io.BytesIO(content)).read("data"))
                entries = [value for value in data.values() if isinstance(value, dict) and ":serialized:" in value]
                decoded = b"".join(base64.b64decode(value[":serialized:"]) for value in entries)
            assert b"numpy._core" not in decoded and b"numpy.core" not in decoded
        assert isinstance(pretrained.load(name).observation_space, gym.spaces.Dict)
