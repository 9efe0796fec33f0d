"""Arguments of an environment as JSON tells them: parts that are objects are named, not kept."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

OBJECT = "object"  # the key under which a part's module and name stand


def described(value: Any) -> Any:
    """JSON form of a value: names, numbers and None as they are, an object as {"object": "module.Name", its fields}."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, Mapping):
        return {str(key): described(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [described(entry) for entry in value]
    if hasattr(value, "tolist"):
        return value.tolist()
    kind = value if hasattr(value, "__qualname__") else type(value)  # a function or class is its own name
    fields = dataclasses.fields(value) if dataclasses.is_dataclass(value) and not isinstance(value, type) else ()
    told = {entry.name: described(getattr(value, entry.name)) for entry in fields}
    return {OBJECT: f"{kind.__module__}.{kind.__qualname__}", **told}


def described_objects(value: Any) -> list[str]:
    """Names of the objects that a JSON form tells of, and cannot bring back."""
    if isinstance(value, Mapping):
        if OBJECT in value:
            return [str(value[OBJECT])]
        return [name for entry in value.values() for name in described_objects(entry)]
    return [name for entry in value for name in described_objects(entry)] if isinstance(value, list) else []
