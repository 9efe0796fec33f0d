"""Fields of a wrong kind are named, whatever check stumbles over them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pytest

from stair_env.common.field_kinds import fits, naming_fields
from stair_env.common.validation import SpecError


@dataclass(frozen=True)
class Config:
    count: int = 1
    share: float = 0.5
    ends: tuple[float, float] = (0.0, 1.0)
    names: Mapping[str, int] = field(default_factory=dict)

    @naming_fields
    def __post_init__(self) -> None:
        if self.count < 1 or not self.ends[0] <= self.share <= self.ends[1]:
            raise ValueError("numbers are out of range")
        list(self.names.items())


@pytest.mark.parametrize(
    "values, says",
    [
        ({"count": "x"}, "count='x' must be int"),
        ({"share": None}, "share=None must be float"),
        ({"ends": 3}, r"ends=3 must be tuple\[float, float\]"),
        ({"names": [1]}, r"names=\[1\] must be Mapping"),
        ({"count": None, "share": "y"}, "count=None .* share='y'"),
    ],
)
def test_the_field_is_named(values: dict[str, Any], says: str) -> None:
    with pytest.raises(SpecError, match=f"Config: .*{says}"):
        Config(**values)


def test_what_the_check_itself_says_is_kept() -> None:
    with pytest.raises(ValueError, match="out of range"):
        Config(count=0)
    assert Config(count=np.int64(2)).count == 2


@pytest.mark.parametrize(
    "value, kind, expected",
    [
        (1, float, True),
        (True, int, False),
        ("x", str | None, True),
        (None, str | None, True),
        (3, str | None, False),
        ([1.0, 2], tuple[float, ...], True),
        ((1.0, "x"), tuple[float, ...], False),
        ((1.0,), tuple[float, float], False),
        ("a", Literal["a", "b"], True),
        ("c", Literal["a", "b"], False),
        (object(), Any, True),
    ],
)
def test_kinds(value: Any, kind: Any, expected: bool) -> None:
    assert fits(value, kind) is expected
