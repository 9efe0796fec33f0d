"""Hyperparameter files, in rl_zoo3's layout: algorithm.yml -> environment id -> values."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

from stair_env.common.constants import ALGORITHMS


def load_hyperparams(algorithm: str, env_id: str, path: Path | str | None = None) -> dict[str, Any]:
    """Read the hyperparameters of an algorithm for an environment.

    Args:
        algorithm: one of ALGORITHMS.
        env_id: environment id, a top-level key of the file.
        path: another YAML file; None reads the shipped one.

    Returns:
        A fresh dict of values as written in the file.

    Raises:
        ValueError: unknown algorithm, no such id in the file, or not a YAML mapping.
        FileNotFoundError: no such file.
    """
    import yaml

    if algorithm not in ALGORITHMS:
        raise ValueError(f"algorithm={algorithm!r} must be one of {', '.join(ALGORITHMS)}")
    file = Path(path) if path else Path(__file__).parent / f"{algorithm}.yml"
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{file} is not YAML: {error}") from None
    if not isinstance(content, dict) or not isinstance(content.get(env_id), dict):
        known = ", ".join(content) if isinstance(content, dict) else "nothing"
        raise ValueError(f"{file} has no hyperparameters for env_id={env_id!r}; it knows {known}")
    return copy.deepcopy(content[env_id])
