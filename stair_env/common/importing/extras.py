"""Libraries that an installation from bare.txt lacks, and errors that say how to get them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

# Distribution by the name that is imported.
DISTRIBUTIONS = {
    "onnxruntime": "onnxruntime",
    "openvino": "openvino",
    "stable_baselines3": "stable-baselines3",
    "torch": "torch",
    "yaml": "pyyaml",
    "imageio": "imageio",
    "safetensors": "safetensors",
    "lightning": "lightning",
    "tensorboard": "tensorboard",
    "onnx": "onnx",
    "onnxscript": "onnxscript",
    "matplotlib": "matplotlib",
    "psutil": "psutil",
    "minari": "'minari[hdf5,create]'",
    "wandb": "wandb",
    "mujoco": "'stair-env[mujoco]'",
    "ray": "'stair-env[ray]'",
}


class MissingExtraError(ModuleNotFoundError):
    """A library is not installed; the message says what to install."""


@contextlib.contextmanager
def naming_extras() -> Iterator[None]:
    """Say what to install when a library is missing inside the block, or inside the function that this decorates.

    Raises:
        MissingExtraError: in place of a ModuleNotFoundError for a library of DISTRIBUTIONS.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library not in DISTRIBUTIONS or isinstance(error, MissingExtraError):
            raise
        wanted = DISTRIBUTIONS[library]
        everything = "" if "[" in wanted else ", or 'stair-env[all]' for everything"  # [all] has no such extras
        raise MissingExtraError(
            f"{library} is not installed: pip install {wanted}{everything}", name=error.name
        ) from error
