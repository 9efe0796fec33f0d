"""Pickling of objects that hold what cannot be pickled: a physics client, a network, a filter of a compiled library."""

from __future__ import annotations

from typing import Any, TypeVar

from gymnasium.utils import EzPickle

T = TypeVar("T", bound="PicklesByArguments")


class PicklesByArguments(EzPickle):
    """Pickled as the arguments it was made with; what comes back is new, as if just made.

    Gymnasium's EzPickle, without every class having to list its arguments.
    """

    def __new__(cls: type[T], *args: Any, **kwargs: Any) -> T:
        """Note the arguments."""
        made: T = super().__new__(cls)
        EzPickle.__init__(made, *args, **kwargs)
        return made
