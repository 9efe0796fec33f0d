"""Policies that Stable-Baselines3 and sb3-contrib saved, rebuilt without running anything that a file says.

Their zips hold pickles, and a pickle may call anything. Here only what a policy is made of may be named in one: spaces,
arrays, network and policy classes. Modules that moved between NumPy 1 and 2 are found under either name.
"""

from __future__ import annotations

import base64
import importlib
import io
import json
import pickle
import re
import zipfile
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import gymnasium as gym
import numpy as np

if TYPE_CHECKING:
    from stable_baselines3.common.policies import BasePolicy

# Names as rl_zoo3 writes them (args.yml), with what tells each from the others in a zip: arguments that it alone saves.
ALGORITHMS: dict[str, tuple[str, ...]] = {
    "ppo": ("clip_range", "n_epochs"),
    "a2c": ("normalize_advantage", "gae_lambda"),
    "sac": ("target_entropy", "target_update_interval"),
    "td3": ("target_policy_noise",),
    "ddpg": ("target_policy_noise",),
    "tqc": ("top_quantiles_to_drop_per_net",),
    "crossq": ("target_entropy", "policy_delay"),
    "trpo": ("cg_max_steps",),
    "ppo_lstm": ("clip_range",),
}
# The order matters: the first whose arguments are all there.
RECOGNISED = ("ppo_lstm", "trpo", "tqc", "crossq", "sac", "ddpg", "td3", "ppo", "a2c")
ALIASES = {"recurrentppo": "ppo_lstm"}
ON_POLICY = ("ppo", "a2c", "trpo", "ppo_lstm")
DATA_FILE, PARAMETERS_FILE = "data", "policy.pth"

_CORE = "numpy._core" if np.lib.NumpyVersion(np.__version__) >= "2.0.0" else "numpy.core"  # 1.26 has a stub of both
_PLAIN = {
    ("numpy", "dtype"),
    ("numpy", "ndarray"),
    (f"{_CORE}.numeric", "_frombuffer"),
    (f"{_CORE}.multiarray", "_reconstruct"),
    (f"{_CORE}.multiarray", "scalar"),
    ("numpy.random._pickle", "__generator_ctor"),
    ("numpy.random._pickle", "__bit_generator_ctor"),
    ("numpy.random._pcg64", "PCG64"),
    ("numpy.random.bit_generator", "__pyx_unpickle_SeedSequence"),
    ("numpy.random.bit_generator", "SeedSequence"),
    ("collections", "OrderedDict"),
    ("collections", "deque"),
    ("builtins", "set"),
    ("builtins", "bytearray"),
    ("_codecs", "encode"),
    ("stable_baselines3.common.vec_env.vec_normalize", "VecNormalize"),
    ("stable_baselines3.common.running_mean_std", "RunningMeanStd"),
}
_CLASSES = (
    "gymnasium.spaces",
    "numpy",
    "policies",
    "sb3_contrib",
    "stable_baselines3",
    "torch.nn.modules",
    "torch.optim",
)
Read = Callable[[bytes], Any]


class SavedModelError(ValueError):
    """A file holds no policy that can be rebuilt; the message says why."""


class SavedModel(NamedTuple):
    """A policy as it was saved.

    Attributes:
        algorithm: that trained it, a name in ALGORITHMS.
        policy: ready to predict.
    """

    algorithm: str
    policy: BasePolicy


class _Reader(pickle.Unpickler):
    """Builds what a policy is made of and nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        module = re.sub(r"^numpy\._?core\b", _CORE, module)
        if (module, name) in _PLAIN:
            return getattr(importlib.import_module(module), name)
        listed = any(module == start or module.startswith(f"{start}.") for start in _CLASSES)
        if not listed or "." in name:
            raise SavedModelError(
                f"it names {module}.{name}, which is not among what a policy is made of (pass trusted=True if you know "
                "where the file comes from)"
            )
        try:
            found = getattr(importlib.import_module(module), name)
        except ModuleNotFoundError as error:
            raise SavedModelError(f"it needs {module}: {_install_hint(error)}") from None
        if not isinstance(found, type) or not issubclass(found, _allowed_bases()):
            raise SavedModelError(f"it names {module}.{name}, which is no class of a space, network or policy")
        return found


def _install_hint(error: ModuleNotFoundError) -> str:
    return "pip install sb3-contrib" if error.name == "sb3_contrib" else str(error)


def _allowed_bases() -> tuple[type, ...]:
    import torch

    return gym.Space, np.generic, torch.nn.Module, torch.optim.Optimizer


def read_pickle(data: bytes) -> Any:
    """Unpickle what a policy is made of: spaces, arrays, classes, statistics of VecNormalize.

    Raises:
        SavedModelError: it names something else, or is no pickle.
    """
    try:
        return _Reader(io.BytesIO(data)).load()
    except SavedModelError:
        raise
    except Exception as error:  # a pickle that is cut or made up fails in any way
        raise SavedModelError(f"it is cut short or damaged ({type(error).__name__}: {error})") from None


def read_model(content: bytes, algorithm: str | None = None, *, trusted: bool = False) -> SavedModel:
    """Rebuild the policy of a zip that `model.save` wrote.

    Args:
        content: of the zip.
        algorithm: that trained it, where another file says so; None recognises it.
        trusted: unpickle without restrictions, which lets the file run code.

    Raises:
        SavedModelError: it is no such zip, or of an algorithm that is not in ALGORITHMS.
    """
    import torch

    read: Read = pickle.loads if trusted else read_pickle
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            data = json.loads(archive.read(DATA_FILE))
            stream = io.BytesIO(archive.read(PARAMETERS_FILE))
        if not isinstance(data, dict):
            raise SavedModelError(f"its {DATA_FILE} is no JSON object")
        name = known_algorithm(algorithm) if algorithm else recognise(data)
        policy = _build(name, {key: _entry(data, key, read) for key in _NEEDED if key in data})
        policy.load_state_dict(torch.load(stream, map_location="cpu", weights_only=True))
    except SavedModelError:
        raise
    except Exception as error:  # cut short, written over, or of a version that differs too much
        raise SavedModelError(f"it is cut short, damaged or no model ({type(error).__name__}: {error})") from None
    policy.set_training_mode(False)
    return SavedModel(name, policy)


_NEEDED = ("observation_space", "action_space", "policy_class", "policy_kwargs", "use_sde")


def _entry(data: Mapping[str, Any], key: str, read: Read) -> Any:
    """A value of the zip's JSON, which holds what JSON cannot as a pickle in text."""
    value = data[key]
    if isinstance(value, dict) and ":serialized:" in value:
        return read(base64.b64decode(value[":serialized:"]))
    return value


def _build(algorithm: str, parts: Mapping[str, Any]) -> BasePolicy:
    from stable_baselines3.common.policies import BasePolicy

    policy_class = parts["policy_class"]
    if not isinstance(policy_class, type) or not issubclass(policy_class, BasePolicy):
        raise SavedModelError(f"its policy class {policy_class!r} is no policy of Stable-Baselines3")
    kwargs = dict(parts["policy_kwargs"])
    if algorithm in ON_POLICY:
        kwargs.setdefault("use_sde", bool(parts.get("use_sde", False)))
    policy: BasePolicy = policy_class(parts["observation_space"], parts["action_space"], _no_learning, **kwargs)
    return policy


def _no_learning(progress: float) -> float:
    return 0.0


def known_algorithm(name: str) -> str:
    """The name in ALGORITHMS of one that rl_zoo3 or a card wrote.

    Raises:
        SavedModelError: it is none of them.
    """
    found = ALIASES.get(name.lower(), name.lower())
    if found not in ALGORITHMS:
        raise SavedModelError(f"it was trained by {name!r}; policies of {', '.join(ALGORITHMS)} can be read")
    return found


def recognise(data: Mapping[str, Any]) -> str:
    """The algorithm by what a zip's JSON holds.

    Raises:
        SavedModelError: it is none of ALGORITHMS.
    """
    policy = data.get("policy_class")
    module = str(policy.get("__module__", "")) if isinstance(policy, dict) else ""
    for name in RECOGNISED:
        if name == "ppo_lstm" and "recurrent" not in module:
            continue
        if name == "ddpg" and (data.get("policy_delay"), data.get("target_noise_clip")) != (1, 0.0):
            continue
        if all(argument in data for argument in ALGORITHMS[name]):
            return name
    signs = f"policy class from {module}" if module else "no policy class"
    raise SavedModelError(f"its algorithm is none of {', '.join(ALGORITHMS)} ({signs})")


def algorithm_in_arguments(text: str) -> str | None:
    """The algorithm that an `args.yml` of rl_zoo3 names; its YAML, which names Python objects, is not loaded."""
    found = re.search(r"^\s*(?:- )+algo\s*\n\s*- (\w+)|^\s*algo:\s*(\w+)", text, re.MULTILINE)
    return next(filter(None, found.groups()), None) if found else None
