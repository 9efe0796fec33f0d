"""A command that is killed at any moment goes on from there, and ends as one that nobody killed."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.slow

KILLS = int(os.environ.get("STAIR_ENV_KILLS", "5"))  # of each command; 20 in all
LONGEST_RUN_S = 600.0
# Arguments of each command, and those with which it goes on after a kill.
DATASET = "--output set --train 40 --val 4 --test 4"
EVALUATE = "--source gait,oracle --stairs random --direction up --episodes 6 --workers 1"
TRAIN = "--output run --timesteps 1024 --num-envs 1 --checkpoint-every 256 --vec dummy"
PERCEPTION_TRAIN = "--data ../frames --output run --epochs 3 --frames-per-epoch 8 --small-share 1 --threads 1"
FRAMES = ["--output", "frames", "--train", "8", "--val", "2", "--test", "2"]  # what perception-train reads
SMALL = ["--set", '{"n_steps": 128, "batch_size": 64, "n_epochs": 1}']
COMMANDS: dict[str, tuple[list[str], list[str]]] = {
    "dataset": (DATASET.split(), []),
    "evaluate": (EVALUATE.split(), ["--resume"]),
    "perception-train": (PERCEPTION_TRAIN.split(), ["--resume"]),
    "train": ([*TRAIN.split(), *SMALL], ["--resume"]),
}


KEPT = {"dataset": ("*.jpg", "*.png", "*.txt"), "perception-train": ("*.safetensors",)}  # the same to the bit


def start(name: str, folder: Path, *arguments: str) -> subprocess.Popen:
    command = [sys.executable, "-W", "ignore", "-m", "stair_env_cli.main", name, "--json", "result.json", *arguments]
    root = str(Path(__file__).resolve().parents[1])
    environment = {**os.environ, "PYTHONPATH": root, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        command, cwd=folder, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, start_new_session=True
    )


def finish(name: str, folder: Path, *arguments: str) -> float:
    begun = time.monotonic()
    process = start(name, folder, *arguments)
    _, errors = process.communicate(timeout=LONGEST_RUN_S)
    assert process.returncode == 0, errors.decode()[-2000:]
    return time.monotonic() - begun


def outcome(name: str, folder: Path) -> Any:
    result = json.loads((folder / "result.json").read_text())
    if name in ("dataset", "perception-train"):
        files = sorted(file for kind in KEPT[name] for file in folder.rglob(kind))
        return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    return result["overall"] if name == "evaluate" else result["timesteps"]


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_kill_9(name: str, tmp_path: Path) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    whole.mkdir()
    killed.mkdir()
    if name == "perception-train":
        finish("dataset", tmp_path, *FRAMES)
    arguments, go_on = COMMANDS[name]
    seconds = finish(name, whole, *arguments)
    for moment in np.random.default_rng(0).uniform(0.05, 1.0, KILLS):
        process = start(name, killed, *arguments, *go_on)
        try:
            _, errors = process.communicate(timeout=float(moment) * seconds)
            assert process.returncode == 0, errors.decode()[-2000:]  # it was done before
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
        for file in killed.rglob("*.json"):  # whole or absent
            json.loads(file.read_text())
    finish(name, killed, *arguments, *go_on)
    assert outcome(name, killed) == outcome(name, whole)
