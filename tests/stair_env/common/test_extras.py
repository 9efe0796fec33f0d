import re
import subprocess
import sys
from pathlib import Path

import pytest

from stair_env.common.importing.extras import DISTRIBUTIONS, MissingExtraError, naming_extras
from stair_env_cli import evaluate
from stair_env_cli.main import main

HEAVY = ("torch", "lightning", "onnx", "onnxruntime", "tensorboard", "matplotlib", "stable_baselines3", "openvino")
HIDE = """
import sys
from importlib.abc import MetaPathFinder
class Hidden(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in {names!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Hidden())
"""
BARE = """
import gymnasium as gym
import numpy as np
import stair_env
from stair_env.rgbd import StairClimbRgbdEnv
env = gym.make("stair_env/StairClimb-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
camera = StairClimbRgbdEnv(camera={"width": 160})
camera.reset(seed=0)
camera.step(np.zeros(16))
vector = gym.make_vec("stair_env/StairClimb-v0", 1)
vector.reset(seed=0)
vector.step(np.zeros((1, 16), np.float32))
vector.close()
"""
PERCEIVED = """
import gymnasium as gym
import stair_env
env = gym.make("stair_env/StairClimbPerception-v0", camera={"width": 160})
env.reset(seed=0)
"""
POLICIES = """
from policies.make_env import make_vec_env
make_vec_env("stair_env/StairClimb-v0", 1)
"""


def run_without(names, code):
    script = HIDE.format(names=names) + code
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=600)


def test_the_environments_run_on_what_bare_txt_lists():
    done = run_without(HEAVY, BARE)
    assert done.returncode == 0, done.stderr[-2000:]


def test_the_perception_id_needs_one_library_and_says_which():
    done = run_without(tuple(name for name in HEAVY if name != "onnxruntime"), PERCEIVED)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "pip install onnxruntime, or 'stair-env[all]'" in run_without(HEAVY, PERCEIVED).stderr


LOAD = "from policies.pretrained import load; load('aliengo')"


@pytest.mark.parametrize("code", [POLICIES, LOAD, "import policies.features"])
def test_policies_say_what_they_need(code):
    done = run_without(HEAVY, code)
    assert done.returncode != 0 and re.search("pip install (torch|stable-baselines3|pyyaml),", done.stderr)


def test_the_command_line_says_it_on_one_line(monkeypatch, capsys):
    def run(args):
        raise ModuleNotFoundError("No module named 'torch'", name="torch")

    monkeypatch.setattr(evaluate, "run", run)
    assert main(["evaluate"]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and "pip install torch," in told


def test_other_missing_modules_stay_what_they_are():
    with pytest.raises(ModuleNotFoundError, match="no_such_module") as caught, naming_extras():
        import no_such_module  # noqa: F401
    assert not isinstance(caught.value, MissingExtraError)


def declared():
    """Lines of bare.txt, and dependencies and extras of pyproject.toml."""
    tomllib = pytest.importorskip("tomllib")  # of Python 3.11
    root = Path(__file__).parents[3]
    lines = (root / "bare.txt").read_text().splitlines()
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    return {line for line in lines if not line.startswith("#")}, project["dependencies"], project


def test_a_plain_installation_has_core_perception_and_policies():
    bare, everything, project = declared()
    assert bare < set(everything)
    for name in ("torch", "stable-baselines3", "onnxruntime", "lightning", "safetensors", "matplotlib"):
        assert any(line.startswith(f"{name}>=") for line in everything) and not any(name in line for line in bare)
    rest = set(everything) - bare | set(project["optional-dependencies"]["openvino"])
    named = {name for module, name in DISTRIBUTIONS.items() if module not in project["optional-dependencies"]}
    assert {re.match("[a-z0-9-]+", line)[0] for line in rest} == {*named, "openvino", "imageio-ffmpeg"}


@pytest.mark.slow
def test_the_environments_run_in_a_fresh_virtual_environment(tmp_path):
    root = Path(__file__).parents[3]
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    python = tmp_path / "venv" / "bin" / "python"
    pip = [python, "-m", "pip", "install", "--quiet"]
    subprocess.run([*pip, "-c", root / "constraints.txt", "-r", root / "bare.txt"], check=True)
    subprocess.run([*pip, "--no-deps", root], check=True, cwd=tmp_path)
    found = subprocess.run([python, "-m", "pip", "freeze"], capture_output=True, text=True, check=True).stdout
    assert not any(name in found for name in ("torch", "lightning", "onnx", "tensorboard", "matplotlib"))
    done = subprocess.run([python, "-c", BARE], cwd=tmp_path, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stderr[-2000:]
