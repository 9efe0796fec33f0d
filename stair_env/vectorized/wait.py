"""Waiting for several worker processes at once."""

from __future__ import annotations

import os
import selectors
import time
from multiprocessing.connection import Connection, wait
from typing import Any

_LET_OTHERS_RUN = getattr(os, "sched_yield", lambda: time.sleep(0))  # there is none on Windows


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

    def ready(self, timeout_s: float, awake_s: float = 0.0) -> list[Any]:
        """Those with something to say; empty if none has within the time.

        Args:
            timeout_s: how long to wait.
            awake_s: how long to look again and again, letting others run, before falling asleep. Who has slept finds
                a cold cache, and waking it takes longer than many a message.
        """
        until = time.perf_counter() + awake_s
        while awake_s and not (found := self._look(0.0)) and time.perf_counter() < until:
            _LET_OTHERS_RUN()
        return found if awake_s and found else self._look(timeout_s)

    def _look(self, timeout_s: float) -> list[Any]:
        if self._selector is None:
            return wait(self._watched, timeout_s)
        return [key.fileobj for key, _ in self._selector.select(timeout_s)]
