"""Every example runs as it is written, with less work."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
ARGUMENTS: dict[str, list[str]] = {
    "train_ppo.py": ["--timesteps", "512", "--num-envs", "1"],
    "perception_in_the_loop.py": ["--episodes", "1"],
    "custom_reward.py": [],
    "own_robot.py": [],
    "joint_actuation.py": ["--timesteps", "1024"],
}
NEED_A_ROBOT = {"ros2_node.py"}  # tested with stand-ins: tests/examples


def test_every_example_is_listed() -> None:
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(ARGUMENTS) | NEED_A_ROBOT


def test_training_example_stays_short() -> None:
    assert len((EXAMPLES / "train_ppo.py").read_text().splitlines()) <= 60


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(ARGUMENTS))
def test_example_runs(name: str, tmp_path: Path) -> None:
    extra = ["--output", str(tmp_path)] if name == "train_ppo.py" else []
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *ARGUMENTS[name], *extra], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip()
