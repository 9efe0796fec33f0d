"""Named numpy arrays in memory that several processes see.

The memory is anonymous: its file is gone before anybody writes to it, so nothing is left behind, however a process
ends.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from multiprocessing.context import BaseContext
from typing import Any

import numpy as np

ALIGNMENT = 64  # bytes: a cache line, so that two workers never write to the same one by the layout's fault

ArrayLayout = Mapping[str, tuple[tuple[int, ...], np.dtype[Any]]]


class SharedArrays:
    """Arrays that a parent makes and hands to its worker processes as an argument.

    Args:
        layout: shape and dtype of each array by name.
        context: of the processes that will share them.
    """

    def __init__(self, layout: ArrayLayout, context: BaseContext) -> None:
        self._layout = {name: (tuple(shape), np.dtype(dtype)) for name, (shape, dtype) in layout.items()}
        self._offsets: dict[str, int] = {}
        size = 0
        for name, (shape, dtype) in self._layout.items():
            self._offsets[name] = size
            size += -(-int(np.prod(shape)) * dtype.itemsize // ALIGNMENT) * ALIGNMENT
        self._memory = context.RawArray(ctypes.c_uint8, max(size, ALIGNMENT))  # zeros

    def views(self) -> dict[str, np.ndarray]:
        """The arrays by name; writing to one is seen by every process."""
        memory = memoryview(self._memory)
        return {
            name: np.frombuffer(memory, dtype, int(np.prod(shape)), self._offsets[name]).reshape(shape)
            for name, (shape, dtype) in self._layout.items()
        }
