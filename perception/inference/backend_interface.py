"""What all back ends share: their interface, the checks of what goes in, the shape of what comes out."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np

from perception.inference.weights import WeightsError
from stair_env.common.constants import GRID_COLUMNS, GRID_ROWS, IMAGE_SIZE


class BackendError(ValueError):
    """A back end cannot run here; the message says what it needs."""


class Backend(Protocol):
    """The network behind numpy."""

    def __call__(self, rgb: np.ndarray, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Detect on a batch.

        Args:
            rgb: uint8 (B, 512, 512, 3).
            depth_m: float32 (B, 512, 512), metres, 0 = no reading.

        Returns:
            cls: float32 (B, 32, 16), probability that the cell holds a line.
            loc: float32 (B, 32, 16, 8), coordinates within the cell in 0..1.

        Raises:
            ValueError: a wrong shape or dtype.
        """


def check_network(file: Path, session: Any) -> None:
    """Refuse a model that is no StairNetV2, which would otherwise fail at the first frame.

    Raises:
        WeightsError: naming what the model takes or gives instead.
    """
    for what, entries, wanted in (
        ("inputs", session.get_inputs(), {"rgb": (3, IMAGE_SIZE, IMAGE_SIZE), "depth": (1, IMAGE_SIZE, IMAGE_SIZE)}),
        ("outputs", session.get_outputs(), {"cls": (1, GRID_ROWS, GRID_COLUMNS), "loc": (8, GRID_ROWS, GRID_COLUMNS)}),
    ):
        found = {entry.name: tuple(entry.shape[1:]) for entry in entries if entry.type == "tensor(float)"}
        if found != wanted:
            raise WeightsError(f"{file}: has {what} {found}, a StairNetV2 has {wanted}")


def as_grids(cls: np.ndarray, loc: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(B, 1, 32, 16) and (B, 8, 32, 16) -> (B, 32, 16) and (B, 32, 16, 8), contiguous float32."""
    grid = np.ascontiguousarray(np.moveaxis(loc, 1, -1), dtype=np.float32)
    return np.ascontiguousarray(cls[:, 0], dtype=np.float32), grid


def empty_answer() -> tuple[np.ndarray, np.ndarray]:
    """What a batch of no frames gives."""
    return np.zeros((0, 32, 16), np.float32), np.zeros((0, 32, 16, 8), np.float32)


def check_batch(rgb: np.ndarray, depth_m: np.ndarray) -> None:
    """Raise ValueError unless rgb is uint8 (B, 512, 512, 3) and depth a float (B, 512, 512)."""
    shape = (IMAGE_SIZE, IMAGE_SIZE)
    if rgb.ndim != 4 or rgb.shape[1:] != (*shape, 3) or rgb.dtype != np.uint8:
        raise ValueError(f"rgb is {rgb.dtype} {rgb.shape}, must be uint8 (B, {IMAGE_SIZE}, {IMAGE_SIZE}, 3)")
    if depth_m.shape != (len(rgb), *shape) or not np.issubdtype(depth_m.dtype, np.floating):
        raise ValueError(f"depth is {depth_m.dtype} {depth_m.shape}, must be float metres ({len(rgb)}, 512, 512)")
