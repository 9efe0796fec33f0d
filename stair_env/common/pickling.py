"""Pickling of objects that hold what cannot be pickled: a physics client, a network, a filter of a compiled library."""

from __future__ import annotations

from typing import Any, TypeVar

T = TypeVar("T", bound="PicklesByArguments")


class PicklesByArguments:
    """Pickled as the arguments it was made with; what comes back is new, as if just made."""

    _made_with: tuple[tuple[Any, ...], dict[str, Any]]

    def __new__(cls: type[T], *args: Any, **kwargs: Any) -> T:
        """Note the arguments."""
        made: T = super().__new__(cls)
        made._made_with = (args, kwargs)
        return made

    def __getstate__(self) -> dict[str, Any]:
        """The arguments alone."""
        return {"made_with": self._made_with}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Become what the arguments make."""
        args, kwargs = state["made_with"]
        self.__dict__.update(type(self)(*args, **kwargs).__dict__)
