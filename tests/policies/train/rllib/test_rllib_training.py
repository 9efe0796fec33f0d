"""RLlib: a run learns, goes on after a kill, and leaves what Stable-Baselines3 would have left."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from policies import pretrained
from policies.make_env import CLIMB_ID, make_env
from policies.rollout import run_episode
from policies.train import checkpoints
from policies.train.curves import read_curve
from policies.train.training import TrainingConfig

ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'stair-env[ray]', or make test-ray")

from policies.train.rllib import rllib_training, runners  # noqa: E402  (loads Ray)

PPO = {"n_steps": 64, "batch_size": 64, "n_epochs": 2}
SAC = {"learning_starts": 100, "buffer_size": 2000, "train_freq": 8, "gradient_steps": 2}
HERE = {"num_env_runners": 0, "num_envs_per_env_runner": 2}  # the toy is registered in this process only
SMALL = {"net_arch": [16, 8]}


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[None]:
    """One for all tests."""
    from stair_env.common.tasks import Engine
    from stair_env.common.tasks.ray_pool import ray_session

    with ray_session(Engine("ray", workers=2)):
        yield


def toy_config(toy_id: str, tmp_path: Path, algorithm: str, steps: int, **hyperparams: Any) -> TrainingConfig:
    values = {
        **(PPO if algorithm == "ppo" else SAC),
        "policy_kwargs": SMALL,
        "normalize": {"norm_obs_keys": ["proprio"]},
    }
    file = tmp_path / "toy.yml"
    file.write_text(json.dumps({toy_id: {"n_timesteps": 10, "n_envs": 2, "rllib": HERE, **values, **hyperparams}}))
    return TrainingConfig(
        algorithm=algorithm,
        env_id=toy_id,
        hyperparams_file=str(file),
        total_timesteps=steps,
        checkpoint_every=128,
        engine="rllib",
    )


def test_a_run_leaves_a_policy_that_acts_as_its_module(
    toy_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for algorithm in ("ppo", "sac"):
        monkeypatch.setattr(rllib_training.translation, "STEPS_PER_ITERATION", 256)
        seen: dict[str, Any] = {}
        write = rllib_training._Training._write_final

        def write_and_ask(run: Any, seen: dict[str, Any] = seen, write: Any = write) -> dict[str, Any]:
            import torch

            observation = {"proprio": np.full(3, 0.4, np.float32), "stair": np.zeros(8, np.float32)}
            batch = {"obs": {key: torch.as_tensor(value)[None] for key, value in observation.items()}}
            run.algorithm.learner_group.foreach_learner(
                lambda learner: seen.update(
                    out=learner.module[runners.MODULE].forward_inference(batch)["action_dist_inputs"].detach().numpy()
                )
            )
            return write(run)

        monkeypatch.setattr(rllib_training._Training, "_write_final", write_and_ask)
        folder = tmp_path / algorithm
        card = rllib_training.train(toy_config(toy_id, tmp_path, algorithm, 512), folder)
        monkeypatch.setattr(rllib_training._Training, "_write_final", write)
        assert card["timesteps"] >= 512 and card["engine"] == "rllib" and card["training"]["episodes"] >= 48
        assert {path.name for path in (folder / "final").iterdir()} == {"model.zip", "vecnormalize.pkl", "card.json"}
        env = make_env(toy_id, monitor=False)
        policy = pretrained.load(folder / "final", env)
        assert policy.algorithm == algorithm
        observation = {"proprio": np.full(3, 0.4, np.float32), "stair": np.zeros(8, np.float32)}
        action, _ = policy.predict(observation)
        mean = seen["out"][0, :2]
        np.testing.assert_allclose(action, np.clip(mean, -1, 1) if algorithm == "ppo" else np.tanh(mean), atol=1e-5)
        newest = checkpoints.list_checkpoints(folder / "checkpoints")[-1]
        pretrained.load(newest, env)
        assert policy.normalisation.obs_rms["proprio"].count > 512


def test_ppo_learns_the_toy_and_goes_on_after_a_kill(
    toy_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = toy_config(toy_id, tmp_path, "ppo", 4096, n_epochs=10, learning_rate=3e-3, gamma=0.0, n_steps=128)
    save, saved = rllib_training._Training._save_policy, []

    def save_then_die(run: Any, folder: Path) -> None:
        save(run, folder)
        saved.append(folder)
        if len(saved) == 3:
            raise KeyboardInterrupt  # in the middle of writing the third checkpoint

    monkeypatch.setattr(rllib_training._Training, "_save_policy", save_then_die)
    with pytest.raises(KeyboardInterrupt):
        rllib_training.train(config, tmp_path / "run")
    monkeypatch.setattr(rllib_training._Training, "_save_policy", save)
    left = checkpoints.list_checkpoints(tmp_path / "run" / "checkpoints")
    assert [checkpoints.read_state(path)["num_timesteps"] for path in left] == [256, 512]
    with pytest.raises(ValueError, match="already holds a run"):
        rllib_training.train(config, tmp_path / "run")
    card = rllib_training.train(config, tmp_path / "run", resume=True)
    rows = read_curve(tmp_path / "run" / "curve.csv")
    steps = [row["timesteps"] for row in rows]
    assert steps == sorted(set(steps)) and steps[-1] == card["timesteps"] == 4096
    assert card["training"]["episodes"] >= 400
    assert card["training"]["return_mean"] > -3.0  # a constant action earns -5


@pytest.mark.slow
def test_a_lost_runner_is_replaced_and_the_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Real stairs, two runners in processes of their own, of which one is killed between two iterations."""
    config = TrainingConfig(
        env_kwargs={"curriculum": True, "max_episode_steps": 40},
        hyperparams={**PPO, "policy_kwargs": SMALL},
        total_timesteps=100_000,
        num_envs=4,
        checkpoint_every=512,
        engine="rllib",
        workers=2,
    )
    iterate, first, replaced = rllib_training._Training._iterate, set[int](), set[int]()

    def iterate_and_kill(run: Any) -> int:
        sampled = iterate(run)
        found = dict(run.algorithm.env_runner_group.foreach_env_runner(who_and_what, local_env_runner=False))
        if not first:
            first.update(found)
            os.kill(next(iter(found)), signal.SIGKILL)
        elif len(found) == 2 and found.keys() != first:
            replaced.update(found.keys() - first)
            mean = run.run.statistics()["proprio"][0]
            assert all(np.allclose(theirs, mean, atol=1e-5) for theirs in found.values())  # the new one knows it, too
            run.total = run.steps
        else:
            time.sleep(1.0)  # a new process takes its time, and the other runner flies on
        return sampled

    monkeypatch.setattr(rllib_training._Training, "_iterate", iterate_and_kill)
    card = rllib_training.train(config, tmp_path / "run")
    assert len(first) == 2 and len(replaced) == 1 and 256 < card["timesteps"] < 100_000
    env = make_env(CLIMB_ID, {"max_episode_steps": 20}, monitor=False)
    assert run_episode(env, pretrained.load(tmp_path / "run" / "final", env), seed=0).control_steps <= 20


def who_and_what(runner: Any) -> tuple[int, np.ndarray]:
    """Process of a runner, and the mean that it normalises with."""
    return os.getpid(), runner.module.normaliser.proprio_mean.numpy()
