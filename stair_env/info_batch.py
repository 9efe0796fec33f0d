"""Infos of many environments in the form that Gymnasium's vector environments give them, made key by key.

The result is that of `VectorEnv._add_info` called for one environment after the other: a dict of arrays, each beside a
mask `_key` of the environments that had the key. Going by key instead of by environment makes each array in one go.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

FINAL_OBSERVATION = "final_obs"  # Gymnasium keeps these as they are, one object per environment


def batch_infos(infos: Mapping[int, dict[str, Any]], num_envs: int) -> dict[str, Any]:
    """Batch infos.

    Args:
        infos: by index of the environment, ascending; environments may be missing, and so may keys.
        num_envs: length of the arrays.
    """
    indices, rows = list(infos), list(infos.values())
    batch: dict[str, Any] = {}
    if len({tuple(row) for row in rows}) == 1:  # the rule: all say the same things
        for key, *values in zip(rows[0], *(row.values() for row in rows)):
            _add(batch, key, indices, values, num_envs)
        return batch
    for key in {key: None for row in rows for key in row}:
        having = [index for index in indices if key in infos[index]]
        _add(batch, key, having, [infos[index][key] for index in having], num_envs)
    return batch


def _add(batch: dict[str, Any], key: str, indices: list[int], values: Sequence[Any], num_envs: int) -> None:
    """Add one key and its mask."""
    batch[key] = _column(key, indices, values, num_envs)
    mask = batch[f"_{key}"] = np.zeros(num_envs, bool)
    mask[slice(None) if len(indices) == num_envs else indices] = True


def _column(key: str, indices: list[int], values: Sequence[Any], num_envs: int) -> Any:
    first = values[0]
    if key == FINAL_OBSERVATION:
        column = np.full(num_envs, None, object)
    elif isinstance(first, dict):
        return batch_infos(dict(zip(indices, values)), num_envs)
    elif type(first) in (int, float, bool) or isinstance(first, np.number):
        if len(indices) == num_envs:
            return np.array(values, type(first))
        column = np.zeros(num_envs, type(first))
    elif isinstance(first, np.ndarray):
        column = np.zeros((num_envs, *first.shape), first.dtype)
    else:
        column = np.full(num_envs, None, object)
    for index, value in zip(indices, values):
        column[index] = value
    return column
