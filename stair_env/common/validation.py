"""Check the values of specifications and arguments, and turn specifications into JSON and back."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

if TYPE_CHECKING:
    from typing_extensions import Self


class SpecError(ValueError):
    """A specification holds a value that cannot be built; the message names field, value and choices."""


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Raise SpecError unless low <= value <= high (NaN never passes)."""
    if not isinstance(value, (int, float, np.integer, np.floating)) or not low <= value <= high:
        raise SpecError(f"{name}={value!r} must be a number in [{low:g}, {high:g}]")


def check_limits(config: object, limits: Mapping[str, tuple[float, float]]) -> None:
    """Raise SpecError unless each field that limits names is a number between its two."""
    for name, (low, high) in limits.items():
        check_range(name, getattr(config, name), low, high)


def check_flags(config: object, *names: str) -> None:
    """Raise SpecError unless each of these fields is True or False."""
    for name in names:
        if not isinstance(getattr(config, name), bool):
            raise SpecError(f"{name}={getattr(config, name)!r} must be True or False")


def check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Raise SpecError unless value is one of choices."""
    if value not in choices:
        raise SpecError(f"{name}={value!r} must be one of {', '.join(map(repr, choices))}")


def has_parts(value: object, names: tuple[str, ...]) -> bool:
    """Whether an object has attributes and methods of these names; a class has none of its instances'."""
    return not isinstance(value, type) and all(hasattr(value, name) for name in names)


def as_range(name: str, value: object, low: float, high: float) -> tuple[float, float]:
    """Read an argument that is one number or two in order, as (low, high).

    Raises:
        SpecError: it is neither, or outside [low, high].
    """
    ends = tuple(value) if isinstance(value, (list, tuple, np.ndarray)) else (value, value)
    if len(ends) != 2 or any(isinstance(end, bool) for end in ends):
        raise SpecError(f"{name}={value!r} must be a number or [low, high]")
    for end in ends:
        check_range(name, end, low, high)
    if ends[0] > ends[1]:
        raise SpecError(f"{name}={value!r} must have low <= high")
    return float(ends[0]), float(ends[1])


def read_action(value: Any, shape: tuple[int, ...], name: str = "action") -> np.ndarray:
    """Read an action (float64), or one for each environment of a vector.

    Args:
        value: what the caller passed.
        shape: that it must have.
        name: of the argument, in messages.

    Raises:
        ValueError: it has another shape, or holds what is no finite number; one NaN would pass through every clip into
            observations, rewards and the statistics of whoever normalises them.
    """
    try:
        action = np.asarray(value, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}={value!r} must hold numbers, of shape {shape}: {error}") from None
    if action.shape != shape:
        raise ValueError(f"{name} has shape {action.shape}, must be {shape}")
    if not np.isfinite(action).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(action))[0])
        where = index[0] if len(index) == 1 else index
        raise ValueError(f"{name} holds {action[index]} at index {where}, must be finite")
    return action


def from_fields(cls: type, values: Any, what: str = "") -> Any:
    """Build dataclass cls from a dict of its fields, of which any may be left out that has a default.

    Args:
        cls: a dataclass.
        values: what JSON held.
        what: name of the value in messages; the class's when not given.

    Raises:
        SpecError: values is no dict or holds an unknown field.
    """
    if not isinstance(values, dict):
        raise SpecError(f"{what or cls.__name__}={values!r} must be a dict of {cls.__name__} fields")
    names = tuple(entry.name for entry in dataclasses.fields(cls))
    for name in values:
        check_choice(f"{what} field".strip(), name, names)
    return build(cls, values, what)


def build(cls: type, values: Mapping[str, Any], what: str = "") -> Any:
    """Build dataclass cls from known fields.

    Raises:
        SpecError: one that has no default is missing, or a value is of a kind that the class cannot even look at.
    """
    absent = dataclasses.MISSING
    required = [f.name for f in dataclasses.fields(cls) if f.default is absent and f.default_factory is absent]
    missing = [name for name in required if name not in values]
    if missing:
        raise SpecError(f"{what or cls.__name__} lacks the field {missing[0]!r}")
    try:
        return cls(**values)
    except (TypeError, AttributeError, OverflowError) as error:
        raise SpecError(f"{what or cls.__name__} field of a wrong kind in {dict(values)!r}: {error}") from None


class JsonSpec:
    """What every specification of stairs, scenes and sensors can do: turn into JSON and back, unchanged."""

    ARGUMENT: ClassVar[str] = ""  # that it is passed as, for messages; the class's name where it is left empty

    def to_dict(self) -> dict[str, Any]:
        """All fields, JSON-able; `from_dict` rebuilds an equal spec."""
        fields: dict[str, Any] = dataclasses.asdict(self)  # type: ignore[call-overload]
        return fields

    def to_json(self) -> str:
        """One JSON object; `from_json` rebuilds an equal spec."""
        return json.dumps(self.to_dict())

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Rebuild a spec.

        Raises:
            SpecError: the text is not a JSON object of this class's fields.
        """
        try:
            values: Any = json.loads(text)
        except json.JSONDecodeError as error:
            raise SpecError(f"not JSON: {error}") from None
        return cls.from_dict(values)

    @classmethod
    def from_dict(cls, values: Any) -> Self:
        """Build from a JSON object; fields that have defaults may be left out.

        Raises:
            SpecError: values is no dict, holds an unknown field or a wrong value.
        """
        built: Self = from_fields(cls, values, cls.ARGUMENT)
        return built


def from_mapping(name: str, cls: type, value: Any) -> Any:
    """Build dataclass cls from its defaults and a mapping of changes.

    Args:
        name: of the argument, in messages.
        cls: a dataclass whose fields all have defaults.
        value: what the caller passed.

    Raises:
        SpecError: value is no mapping or holds an unknown field.
    """
    fields = tuple(field.name for field in dataclasses.fields(cls))
    if not isinstance(value, Mapping):
        raise SpecError(f"{name}={value!r} must be None, True or a mapping with any of {', '.join(fields)}")
    for key in value:
        check_choice(f"{name} field", key, fields)
    return build(cls, value, name)
