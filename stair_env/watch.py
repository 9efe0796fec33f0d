"""Waiting for several worker processes at once."""

from __future__ import annotations

import selectors
from multiprocessing.connection import Connection, wait
from typing import Any


class Watch:
    """Knows its sources from the start; `multiprocessing.connection.wait` registers all of them anew at each call."""

    def __init__(self) -> None:
        self._watched: list[Any] = []
        poll = getattr(selectors, "PollSelector", None)  # there is none on Windows
        self._selector: selectors.BaseSelector | None = poll() if poll else None

    def add(self, source: Connection | int) -> None:
        """Watch a connection for messages, or a process's sentinel."""
        self._watched.append(source)
        if self._selector is not None:
            self._selector.register(source, selectors.EVENT_READ)

    def ready(self, timeout_s: float) -> list[Any]:
        """Those with something to say; empty if none has within the time."""
        if self._selector is None:
            return wait(self._watched, timeout_s)
        return [key.fileobj for key, _ in self._selector.select(timeout_s)]
