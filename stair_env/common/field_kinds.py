"""Name the field when a dataclass is given a value of a kind that its checks cannot even look at."""

from __future__ import annotations

import dataclasses
import functools
import types
import typing
from collections.abc import Callable
from typing import Any

import numpy as np

from stair_env.common.validation import SpecError

UNREADABLE = (TypeError, AttributeError, OverflowError)  # what comparing, iterating or looking up raises
NUMBERS: dict[type, tuple[type, ...]] = {float: (int, float, np.integer, np.floating), int: (int, np.integer)}


def naming_fields(check: Callable[[Any], None]) -> Callable[[Any], None]:
    """Decorate a `__post_init__`: what it cannot compare or iterate becomes a SpecError that names field and value."""

    @functools.wraps(check)
    def checked(config: Any) -> None:
        try:
            check(config)
        except UNREADABLE as error:
            told = ", ".join(_wrong_kinds(config)) or f"a field is of a wrong kind: {error}"
            raise SpecError(f"{type(config).__name__}: {told}") from None

    return checked


def _wrong_kinds(config: Any) -> list[str]:
    try:
        kinds = typing.get_type_hints(type(config))
    except NameError:  # a kind that only type checkers import
        kinds = {}
    fields = [(field, getattr(config, field.name, None)) for field in dataclasses.fields(config)]
    wrong = [(field, value) for field, value in fields if not fits(value, kinds.get(field.name, Any))]
    return [f"{field.name}={value!r} must be {_in_words(field.type)}" for field, value in wrong]


def _in_words(kind: Any) -> str:
    return kind if isinstance(kind, str) else getattr(kind, "__name__", str(kind))


def fits(value: Any, kind: Any) -> bool:
    """Whether a value is of an annotated kind, as far as that can be told; a list does for a tuple.

    Args:
        value: any.
        kind: an annotation.
    """
    if kind is Any:
        return True
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        return any(fits(value, part) for part in inner)
    if origin is typing.Literal:
        return any(value is part or value == part for part in inner)
    if kind in NUMBERS:
        return isinstance(value, NUMBERS[kind]) and not isinstance(value, bool)
    if (origin or kind) is tuple:
        return isinstance(value, (tuple, list)) and _all_fit(value, inner)
    known = origin or kind
    return not isinstance(known, type) or isinstance(value, known)


def _all_fit(values: tuple[Any, ...] | list[Any], kinds: tuple[Any, ...]) -> bool:
    if not kinds:
        return True
    if kinds[-1] is Ellipsis:
        return all(fits(value, kinds[0]) for value in values)
    return len(values) == len(kinds) and all(map(fits, values, kinds))
