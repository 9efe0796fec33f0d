"""Entry points of ids whose environments are built in a package that imports this one."""

from __future__ import annotations

from typing import Any

from stair_env.common.importing.shadowing import import_sibling
from stair_env.env import StairClimbEnv

_BUILDER = "perception.gym_entry_points"


def make_perception_env(**kwargs: Any) -> Any:
    """See `perception.gym_entry_points.make_perception_env`.

    Raises:
        ShadowedPackageError: another package called `perception` is in the way.
    """
    return import_sibling(_BUILDER).make_perception_env(**kwargs)


def make_perception_vec(num_envs: int = 1, **kwargs: Any) -> Any:
    """See `perception.gym_entry_points.make_perception_vec`.

    Raises:
        ShadowedPackageError: another package called `perception` is in the way.
    """
    return import_sibling(_BUILDER).make_perception_vec(num_envs, **kwargs)


# `gymnasium.make` looks here for render modes, to make "rgb_array_list" of "rgb_array".
make_perception_env.metadata = StairClimbEnv.metadata  # type: ignore[attr-defined]
