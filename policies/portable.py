"""Files of a policy in a form that every supported version of NumPy reads, with the same numbers in them.

NumPy pickles its arrays under the names of private modules, which moved between 1.26 and 2.0. Here arrays are pickled
as calls of public names, and what only a training needs is left out.
"""

from __future__ import annotations

import base64
import copyreg
import io
import json
import pickle
import zipfile
from typing import Any

import gymnasium as gym
import numpy as np

from policies.saved_models import DATA_FILE, PARAMETERS_FILE, read_pickle

PROTOCOL = 4
REWRITTEN = ("observation_space", "action_space")
# What a training goes on with, and nothing that acts: observations and infos of its last step.
DROPPED = ("_last_obs", "_last_episode_starts", "_last_original_obs", "ep_info_buffer", "ep_success_buffer")
KEPT_FILES = (DATA_FILE, PARAMETERS_FILE, "pytorch_variables.pth", "_stable_baselines3_version", "system_info.txt")
OPTIMISER_SUFFIX = ".optimizer.pth"
OF_ENVIRONMENTS = ("venv", "class_attributes", "returns")
ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # the same file whenever it is written


class _Writer(pickle.Pickler):
    """Pickles arrays and NumPy's numbers as calls of public names; forgets random generators."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, np.ndarray) and obj.dtype != object:
            array = np.ascontiguousarray(obj)
            return np.ndarray, (obj.shape, obj.dtype.str, bytearray(array.tobytes()))
        if isinstance(obj, np.generic):
            return type(obj), (obj.item(),)
        if isinstance(obj, gym.Space):
            obj._np_random = None  # type: ignore[assignment]
        if type(obj).__name__ == "VecNormalize":  # its own __getstate__ wants the environments that a file has not
            state = {name: value for name, value in vars(obj).items() if name not in OF_ENVIRONMENTS}
            return copyreg.__newobj__, (type(obj),), state  # type: ignore[attr-defined]
        return NotImplemented


def write_pickle(value: Any) -> bytes:
    """Pickle a value in the portable form."""
    buffer = io.BytesIO()
    _Writer(buffer, PROTOCOL).dump(value)
    return buffer.getvalue()


def portable(name: str, content: bytes) -> bytes:
    """The portable form of a policy's file.

    Args:
        name: of the file; a zip is a model, anything else a pickle.
        content: what it holds.

    Raises:
        SavedModelError: the file is damaged, or holds what does not belong in a policy.
    """
    return _portable_zip(content) if name.endswith(".zip") else write_pickle(read_pickle(content))


def _portable_zip(content: bytes) -> bytes:
    source = zipfile.ZipFile(io.BytesIO(content))
    data = json.loads(source.read(DATA_FILE))
    for key in REWRITTEN:
        value = read_pickle(base64.b64decode(data[key][":serialized:"]))
        data[key] = {":type:": str(type(value)), ":serialized:": base64.b64encode(write_pickle(value)).decode()}
    for key in DROPPED:
        data[key] = None
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as target:
        for name in source.namelist():
            if name in KEPT_FILES or name.endswith(OPTIMISER_SUFFIX):
                text = json.dumps(data, indent=4).encode() if name == DATA_FILE else source.read(name)
                target.writestr(zipfile.ZipInfo(name, ZIP_DATE), text)
    return buffer.getvalue()
