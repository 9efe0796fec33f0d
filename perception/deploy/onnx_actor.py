"""A trained policy as its exported file: observation in, action out, by ONNX Runtime and numpy alone.

`python -m policies.export_actor NAME FOLDER` writes the folder: `actor.onnx` (normalised observation to action),
`normalisation.npz` (what VecNormalize had learned) and `actor.json` (names and sizes).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from stair_env.observation import STAIR_FIELDS

MODEL, STATISTICS, NOTE = "actor.onnx", "normalisation.npz", "actor.json"
KEYS = ("proprio", "stair")
FORMAT = 1


class ActorError(ValueError):
    """An exported policy cannot be used; the message names the file."""


class OnnxActor:
    """An exported policy.

    Args:
        folder: that holds the three files.

    Attributes:
        name: of the policy.
        robot: that it was trained on; "" when its card says none.
        action_size, proprio_size: numbers.

    Raises:
        ActorError: a file is missing, broken, or of another format.
    """

    def __init__(self, folder: str | Path) -> None:
        folder = Path(folder)
        for name in (MODEL, STATISTICS, NOTE):
            if not (folder / name).is_file():
                raise ActorError(
                    f"{folder / name}: no such file; `python -m policies.export_actor NAME FOLDER` writes it"
                )
        note = _read_note(folder / NOTE)
        self.name, self.robot = str(note["name"]), str(note.get("robot", ""))
        self.action_size, self.proprio_size = int(note["action_size"]), int(note["proprio_size"])
        self._session = _open(folder / MODEL)
        try:
            with np.load(folder / STATISTICS, allow_pickle=False) as found:
                self._statistics = {key: found[key] for key in found.files}
        except (OSError, ValueError, EOFError) as error:
            raise ActorError(f"{folder / STATISTICS}: cannot be read: {error}") from None

    def act(self, observation: Mapping[str, np.ndarray]) -> np.ndarray:
        """The most likely action.

        Args:
            observation: `proprio` (n,) and `stair` (8,), float32, as the environment gives them.

        Returns:
            (action_size,) float32 in [-1, 1].

        Raises:
            ValueError: a part is missing or has a wrong shape.
        """
        sizes = {"proprio": self.proprio_size, "stair": len(STAIR_FIELDS)}
        inputs = {}
        for key in KEYS:
            values = np.asarray(observation.get(key, ()), np.float32)
            if values.shape != (sizes[key],):
                raise ValueError(f"{key} has shape {values.shape}, must be ({sizes[key]},)")
            inputs[key] = self._normalised(key, values)[None]
        action: np.ndarray = self._session.run(["action"], inputs)[0][0]
        return np.clip(action, -1.0, 1.0)

    def _normalised(self, key: str, values: np.ndarray) -> np.ndarray:
        """As VecNormalize does it: float64, clipped, back to float32."""
        if f"{key}_mean" not in self._statistics:
            return values
        mean, variance = self._statistics[f"{key}_mean"], self._statistics[f"{key}_var"]
        epsilon, clip = float(self._statistics["epsilon"]), float(self._statistics["clip"])
        scaled = np.clip((values - mean) / np.sqrt(variance + epsilon), -clip, clip)
        return np.asarray(scaled, np.float32)


def _read_note(path: Path) -> dict[str, Any]:
    try:
        note = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ActorError(f"{path}: not JSON: {error}") from None
    if not isinstance(note, dict) or note.get("format") != FORMAT:
        raise ActorError(f"{path}: is of another format than {FORMAT}; export the policy again")
    return note


def _open(path: Path) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1  # a network of this size is one thread's work
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # the runtime's errors share no base class
        raise ActorError(f"{path}: cannot be loaded: {' '.join(str(error).split())}") from error
    names = sorted(entry.name for entry in session.get_inputs())
    if names != sorted(KEYS):
        raise ActorError(f"{path}: has inputs {names}, an exported policy has {', '.join(KEYS)}")
    return session
