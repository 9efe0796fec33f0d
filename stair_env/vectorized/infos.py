"""Infos of many environments in the form that Gymnasium's vector environments give them, made key by key.

The result is that of `VectorEnv._add_info` called for one environment after the other: a dict of arrays, each beside a
mask `_key` of the environments that had the key. Going by key instead of by environment makes each array in one go.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

FINAL_OBSERVATION = "final_obs"  # Gymnasium keeps these as they are, one object per environment
PLAIN_NUMBERS = (float, int, bool)


def batch_infos(infos: Mapping[int, dict[str, Any]], num_envs: int) -> dict[str, Any]:
    """Batch infos.

    Args:
        infos: by index of the environment, ascending; environments may be missing, and so may keys.
        num_envs: length of the arrays.
    """
    indices, rows = list(infos), list(infos.values())
    if len(rows) == num_envs and len({tuple(row) for row in rows}) == 1:  # the rule: all say the same things
        return _uniform(rows)
    batch: dict[str, Any] = {}
    for key in {key: None for row in rows for key in row}:
        having = [index for index in indices if key in infos[index]]
        batch[key] = _column(key, having, [infos[index][key] for index in having], num_envs)
        mask = batch[f"_{key}"] = np.zeros(num_envs, bool)
        mask[having] = True
    return batch


def _uniform(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Batch the infos of all environments, which have the same keys; arrays of one kind are rows of one array."""
    columns = dict(zip(rows[0], zip(*(row.values() for row in rows))))
    masks = np.ones((len(columns), len(rows)), bool)
    batch: dict[str, Any] = {f"_{key}": mask for key, mask in zip(columns, masks)}
    for kind in PLAIN_NUMBERS:
        keys = [key for key, values in columns.items() if type(values[0]) is kind]
        if keys:
            batch.update(zip(keys, np.array([columns[key] for key in keys], kind)))
    for key, values in columns.items():
        if key not in batch:
            batch[key] = _column(key, range(len(rows)), values, len(rows))
    return batch


def _column(key: str, indices: Sequence[int], values: Sequence[Any], num_envs: int) -> Any:
    first = values[0]
    if key == FINAL_OBSERVATION:
        column = np.full(num_envs, None, object)
    elif isinstance(first, dict):
        return batch_infos(dict(zip(indices, values)), num_envs)
    elif type(first) in PLAIN_NUMBERS or isinstance(first, np.number):
        column = np.zeros(num_envs, type(first))
    elif isinstance(first, np.ndarray):
        column = np.zeros((num_envs, *first.shape), first.dtype)
    else:
        column = np.full(num_envs, None, object)
    for index, value in zip(indices, values):
        column[index] = value
    return column
