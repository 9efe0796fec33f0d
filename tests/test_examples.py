"""Every example runs as it is written, with less work; their parts run in worker processes too."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import cloudpickle
import gymnasium as gym
import numpy as np
import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
PLAIN = "stair_env/StairClimb-v0"
ARGUMENTS: dict[str, list[str]] = {
    "train_ppo.py": ["--timesteps", "512", "--num-envs", "1"],
    "perception_in_the_loop.py": ["--episodes", "1"],
    "joint_actuation.py": ["--timesteps", "1024"],
    "own_gait.py": [],
    "own_reward.py": [],
    "own_robot.py": [],
    "own_terrain.py": [],
}
PARTS = [name for name in ARGUMENTS if name.startswith("own_")]
MAX_PART_LINES = 20


def load(name: str) -> ModuleType:
    """An example as a module that no other process can import, like a script of one's own."""
    spec = importlib.util.spec_from_file_location(f"example_{Path(name).stem}", EXAMPLES / name)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(params=[*PARTS, "own_gait.py class"])
def own_kwargs(request: pytest.FixtureRequest, tmp_path: Path) -> dict[str, Any]:
    name, _, variant = request.param.partition(" ")
    module = load(name)
    # What a script defines is `__main__`'s, which cloudpickle sends by value; so are these.
    sys.modules[module.__name__] = module
    cloudpickle.register_pickle_by_value(module)
    request.addfinalizer(lambda: sys.modules.pop(module.__name__))
    request.addfinalizer(lambda: cloudpickle.unregister_pickle_by_value(module))
    if name == "own_robot.py":
        kwargs: dict[str, Any] = module.make_kwargs(module.write_urdf(tmp_path))
        return kwargs
    if name == "own_gait.py":
        return {"gait": module.CautiousTrot if variant else module.WALK}
    return dict(module.ENV_KWARGS)


def walk_alone(kwargs: dict[str, Any], steps: int) -> tuple[np.ndarray, list[float]]:
    env = gym.make(PLAIN, **kwargs)
    env.reset(seed=3)
    rewards = []
    for _ in range(steps):
        observation, reward, *_ = env.step(np.zeros(16, np.float32))
        rewards.append(float(reward))
    env.close()
    return observation["proprio"], rewards


NEED_A_ROBOT = {"ros2_node.py"}  # tested with stand-ins: tests/examples


def test_every_example_is_listed() -> None:
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(ARGUMENTS) | NEED_A_ROBOT


def test_training_example_stays_short() -> None:
    assert len((EXAMPLES / "train_ppo.py").read_text().splitlines()) <= 60


@pytest.mark.parametrize("name", PARTS)
def test_parts_are_short_and_use_public_names_only(name: str) -> None:
    text = (EXAMPLES / name).read_text()
    lines = [line.strip() for line in text.splitlines()]
    start = next(i for i, line in enumerate(lines) if line.startswith("# --- the part"))
    code = [line for line in lines[start + 1 : lines.index("# --- end of the part")] if line]
    assert len(code) < MAX_PART_LINES
    assert "._" not in text and "import _" not in text


@pytest.mark.parametrize("context", ["spawn", "forkserver"])
def test_parts_run_in_our_workers(own_kwargs: dict[str, Any], context: str) -> None:
    proprio, rewards = walk_alone(own_kwargs, 12)
    vector = gym.make_vec(PLAIN, 2, vectorization_mode="vector_entry_point", context=context, **own_kwargs)
    vector.reset(seed=[3, 3])
    for reward in rewards:
        observation, both, *_ = vector.step(np.zeros((2, 16), np.float32))
        assert both.tolist() == [reward, reward]
    vector.close()
    np.testing.assert_array_equal(observation["proprio"], np.stack([proprio, proprio]))


def test_parts_run_in_gymnasiums_and_sb3s_vectors(own_kwargs: dict[str, Any]) -> None:
    from stable_baselines3.common.vec_env import SubprocVecEnv

    from policies.make_env import make_env

    proprio, rewards = walk_alone(own_kwargs, 6)
    sync = gym.make_vec(PLAIN, 2, vectorization_mode="sync", **own_kwargs)
    sync.reset(seed=[3, 3])
    venv = SubprocVecEnv([lambda: make_env(PLAIN, own_kwargs)], start_method="spawn")
    venv.seed(3)
    venv.reset()
    for reward in rewards:
        both = sync.step(np.zeros((2, 16), np.float32))[1]
        observation, own, _, _ = venv.step(np.zeros((1, 16), np.float32))
        assert both.tolist() == [reward, reward] and own[0] == reward
    np.testing.assert_array_equal(observation["proprio"][0], proprio)
    venv.close()
    sync.close()


@pytest.mark.parametrize("name", PARTS)
def test_parts_run_as_scripts(name: str) -> None:
    done = subprocess.run([sys.executable, str(EXAMPLES / name)], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip()


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(ARGUMENTS) - set(PARTS)))
def test_example_runs(name: str, tmp_path: Path) -> None:
    extra = ["--output", str(tmp_path)] if name == "train_ppo.py" else []
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *ARGUMENTS[name], *extra], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip()
