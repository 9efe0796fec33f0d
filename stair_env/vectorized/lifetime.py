"""How worker processes are started and ended, and what an exit code says."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess

from stair_env.common.validation import check_choice

CLOSE_TIMEOUT_S = 5.0  # a worker that has not gone by then is killed


def start_context(name: str | None) -> BaseContext:
    """The start method of this name; None takes "forkserver" where there is one, else "spawn".

    Raises:
        ValueError: there is no such start method here.
    """
    available = multiprocessing.get_all_start_methods()
    if name is None:
        name = "forkserver" if "forkserver" in available else "spawn"
    check_choice("context", name, tuple(available))
    return multiprocessing.get_context(name)


def exit_cause(exitcode: int | None) -> str:
    """An exit code in words; None is a process that still lives but cannot be talked to."""
    if exitcode is None:
        return "its pipe broke"
    if exitcode >= 0:
        return f"exit code {exitcode}"
    try:
        return f"exit code {exitcode} ({signal.Signals(-exitcode).name})"
    except ValueError:
        return f"exit code {exitcode}"


def end_processes(owner: int, processes: list[BaseProcess], connections: list[Connection]) -> None:
    """Ask the workers to go, kill those that do not.

    Args:
        owner: the process that started them; in any other this does nothing.
        processes: that run `stair_env.vectorized.worker.run_worker`.
        connections: one to each.
    """
    if os.getpid() != owner:
        return
    deadline = time.monotonic() + CLOSE_TIMEOUT_S
    for connection in connections:
        try:
            connection.send(None)
        except OSError:
            continue
    while (alive := [p for p in processes if p.is_alive()]) and time.monotonic() < deadline:
        for connection in connections:  # an answer that nobody reads would keep its worker from going
            _drain(connection)
        wait([process.sentinel for process in alive], 0.1)
    for process in processes:
        if process.is_alive():
            process.kill()
        process.join()
    for connection in connections:
        connection.close()


def _drain(connection: Connection) -> None:
    try:
        while connection.poll():
            connection.recv_bytes()
    except (EOFError, OSError):
        return
