"""Which extra of the distribution brings which library, and errors that say so."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

EXTRA_OF = {
    "onnxruntime": "perception",
    "openvino": "openvino",
    "stable_baselines3": "policies",
    "torch": "policies",
    "yaml": "policies",
    "imageio": "policies",
    "safetensors": "train",
    "lightning": "train",
    "tensorboard": "train",
    "onnx": "train",
    "onnxscript": "train",
    "matplotlib": "train",
    "psutil": "train",
    "minari": "minari",
    "wandb": "wandb",
}


class MissingExtraError(ModuleNotFoundError):
    """A library is not installed; the message names the extra that brings it."""


@contextlib.contextmanager
def naming_extras() -> Iterator[None]:
    """Name the extra when a library is missing inside the block, or inside the function that this decorates.

    Raises:
        MissingExtraError: in place of a ModuleNotFoundError for a library of EXTRA_OF.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library not in EXTRA_OF or isinstance(error, MissingExtraError):
            raise
        extra = EXTRA_OF[library]
        raise MissingExtraError(
            f"{library} is not installed: pip install 'stair-env[{extra}]', or 'stair-env[all]' for everything",
            name=error.name,
        ) from error
