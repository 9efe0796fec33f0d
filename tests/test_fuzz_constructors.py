"""Every configuration of the packages, given any values: it is built, or a ValueError says what does not fit."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import perception
import policies
import stair_env

ODD: tuple[Any, ...] = (
    None, True, -1, 0, 1, 2, 10**20, -1e20, float("nan"), float("inf"), 0.1, 1e300, "", "x", "\ud800", b"", b"ab", [],
    [1], [None], [float("nan"), 1], [2, 1], (0.1, 0.2), (1, 2, 3), {}, {"a": 1}, np.zeros(0), np.zeros((2, 2)),
    np.array("x"), object(), {1}, range(3), 1 + 2j, len,
)  # fmt: skip
INNER = "perception.reproduction.tables_2_3_6"  # rows of tables that the package alone makes


def configurations(package: ModuleType) -> list[type]:
    """Dataclasses that check themselves."""
    found = []
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        try:
            members = vars(importlib.import_module(module.name))
        except ImportError:  # an extra that is not installed
            continue
        found += [kind for kind in members.values() if _checks_itself(kind, module.name)]
    return found


def _checks_itself(kind: Any, module: str) -> bool:
    own = inspect.isclass(kind) and kind.__module__ == module and not module.startswith(INNER)
    public = own and not kind.__name__.startswith("_") and dataclasses.is_dataclass(kind)
    return public and not inspect.isabstract(kind) and hasattr(kind, "__post_init__")


@pytest.mark.parametrize("package", [stair_env, perception, policies], ids=lambda package: package.__name__)
def test_any_values(package: ModuleType) -> None:
    kinds = configurations(package)
    assert len(kinds) > 5

    @settings(max_examples=300, deadline=None)
    @given(st.data())
    def check(data: st.DataObject) -> None:
        kind = data.draw(st.sampled_from(kinds))
        parameters = inspect.signature(kind).parameters.values()
        needed = [p.name for p in parameters if p.default is p.empty]
        changed = data.draw(st.lists(st.sampled_from([p.name for p in parameters]), max_size=2))
        try:
            kind(**{name: data.draw(st.sampled_from(ODD)) for name in dict.fromkeys([*needed, *changed])})
        except ValueError as error:
            assert str(error)

    check()
