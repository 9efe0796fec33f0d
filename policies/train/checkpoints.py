"""Checkpoints of a training run: whole or absent, and enough to go on as if nothing had happened.

A checkpoint is a folder `step_000012288/` with the model, the normalisation statistics, the curriculum levels, the
random state, and for off-policy algorithms the replay buffer. It is written under another name and renamed when
complete, so a kill at any moment leaves the previous one.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stair_env.common.files import read_json_object

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecEnv

MODEL_FILE = "model.zip"
NORMALISATION_FILE = "vecnormalize.pkl"
STATE_FILE = "state.json"
RANDOM_FILE = "random.pkl"
REPLAY_FILE = "replay_buffer.pkl"
FOLDER_PREFIX = "step_"
CURRICULUM_GETTER = "get_curriculum_state"
CURRICULUM_SETTER = "set_curriculum_state"


def save_checkpoint(model: BaseAlgorithm, folder: Path, *, keep: int = 2, replay_buffer: bool = True) -> Path:
    """Write `folder/step_N` atomically and drop all but the newest `keep`.

    Args:
        model: the model, with its environments attached.
        folder: the run's folder of checkpoints, made if missing.
        keep: how many checkpoints stay.
        replay_buffer: whether an off-policy model's replay buffer is written too.

    Returns:
        The checkpoint's folder.
    """
    target = folder / f"{FOLDER_PREFIX}{model.num_timesteps:09d}"
    partial = folder / f".partial_{target.name}"
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    save_policy(model, partial)
    if replay_buffer and getattr(model, "replay_buffer", None) is not None:
        model.save_replay_buffer(partial / REPLAY_FILE)  # type: ignore[attr-defined]
    state = {"num_timesteps": model.num_timesteps, "curriculum": curriculum_states(model.get_env())}
    (partial / STATE_FILE).write_text(json.dumps(state), encoding="utf-8")
    (partial / RANDOM_FILE).write_bytes(pickle.dumps(_random_state()))
    shutil.rmtree(target, ignore_errors=True)
    os.replace(partial, target)
    for old in list_checkpoints(folder)[:-keep]:
        shutil.rmtree(old, ignore_errors=True)
    return target


def save_policy(model: BaseAlgorithm, folder: Path) -> None:
    """Write what it takes to use the policy: the model and its normalisation statistics."""
    folder.mkdir(parents=True, exist_ok=True)
    model.save(folder / MODEL_FILE)
    normalisation = model.get_vec_normalize_env()
    if normalisation is not None:
        normalisation.save(str(folder / NORMALISATION_FILE))


def list_checkpoints(folder: Path) -> list[Path]:
    """Complete checkpoints, oldest first."""
    return sorted(path for path in folder.glob(f"{FOLDER_PREFIX}*") if (path / STATE_FILE).is_file())


@contextlib.contextmanager
def naming_damage(checkpoint: Path) -> Iterator[None]:
    """Turn whatever reading a damaged checkpoint raises inside the block into one error that names it.

    Raises:
        ValueError: in place of anything but a lack of memory.
    """
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:  # of zip files, pickles, torch and Stable-Baselines3, which share no base class
        told = " ".join(str(error).split())[:200]
        raise ValueError(
            f"{checkpoint}: damaged or cut short, remove this folder to go on from the one before: "
            f"{type(error).__name__}: {told}"
        ) from error


def read_state(checkpoint: Path) -> dict[str, Any]:
    """The checkpoint's `num_timesteps` and `curriculum`."""
    return read_json_object(checkpoint / STATE_FILE)


def restore_random_state(checkpoint: Path) -> None:
    """Put the generators of Python, NumPy and torch back to where the checkpoint was written."""
    import torch

    state = pickle.loads((checkpoint / RANDOM_FILE).read_bytes())
    random.setstate(state["python"])
    np.random.set_state(state["numpy"])  # noqa: NPY002  (SB3 draws from the global generator)
    torch.set_rng_state(state["torch"])


def _random_state() -> dict[str, Any]:
    import torch

    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(),  # noqa: NPY002
        "torch": torch.get_rng_state(),
    }


def curriculum_states(venv: VecEnv | None) -> list[Any] | None:
    """The curriculum of each environment, JSON-able; None where the environments have none."""
    if venv is None:
        return None
    states = list(venv.env_method(CURRICULUM_GETTER))
    return states if any(state is not None for state in states) else None


def restore_curriculum(venv: VecEnv, states: list[Any] | None) -> None:
    """Give each environment its curriculum back; with another number of environments they share the states in turn."""
    if not states:
        return
    for index in range(venv.num_envs):
        venv.env_method(CURRICULUM_SETTER, states[index % len(states)], indices=[index])
