"""Tasks on a Ray cluster: one that is running somewhere, or one on this machine that ends with the work.

A task whose worker or node is lost runs again elsewhere, and so does one whose result went with its node. Since a
task's seed is in its item, it brings the same result.
"""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Any

from stair_env.common.importing.extras import naming_extras
from stair_env.common.tasks.engine import Engine, EngineError
from stair_env.common.tasks.local_pool import THREAD_VARIABLES

RETRIES = 8  # of a task whose worker is lost; one that takes its workers down itself ends the run then
AHEAD = 4  # tasks a core that are handed out
LEAST_AHEAD = 64  # so that a cluster which grows with its work sees that there is more
LOOK_EVERY_S = 5.0  # at how many cores the cluster has
KNOCK_S = 10.0  # that a cluster has to answer
STORE_BYTES = 200_000_000  # for results on their way, of a cluster that is started here
NICENESS = "RAY_worker_niceness"  # Ray's own default, 15, leaves workers what everything else on the machine leaves
ENVIRONMENT = {"env_vars": dict.fromkeys(THREAD_VARIABLES, "1")}  # of every worker


@contextlib.contextmanager
def ray_session(engine: Engine) -> Iterator[Any]:
    """The module `ray`, connected; a connection that was open before stays open afterwards.

    Raises:
        MissingExtraError: Ray is not installed.
        EngineError: no cluster answers at the address.
    """
    with naming_extras():
        import ray

    if ray.is_initialized():
        yield ray
        return
    if engine.address is not None:
        _knock(engine.address)
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    if engine.address is None:
        os.environ.setdefault(NICENESS, "0")  # read by the processes that start now
        quiet |= {"num_cpus": engine.workers, "object_store_memory": STORE_BYTES, "include_dashboard": False}
    try:
        ray.init(address=engine.address or "local", **quiet)
    except (ConnectionError, RuntimeError, ValueError) as error:
        where = f"at ray_address={engine.address!r}" if engine.address else "on this machine"
        raise EngineError(f"no Ray cluster {where}: {error}") from error
    try:
        yield ray
    finally:
        ray.shutdown()


def _knock(address: str) -> None:
    """Find out in seconds what Ray finds out in minutes: that nobody listens at an address.

    Raises:
        EngineError: nobody does.
    """
    host, _, port = address.rpartition("://")[2].partition("?")[0].rpartition(":")
    if not port.isdigit():
        return  # "auto", or a name that Ray resolves itself
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=KNOCK_S).close()
    except OSError as error:
        raise EngineError(f"no Ray cluster at ray_address={address!r}: {error}") from error


def run_on_ray(
    function: Callable[[Any, Any], Any], items: Sequence[Any], engine: Engine, shared: Any
) -> Iterator[tuple[Any, Any]]:
    """See `run_tasks`."""
    with ray_session(engine) as ray:
        task = ray.remote(num_cpus=1, max_retries=RETRIES, runtime_env=ENVIRONMENT)(function)
        reference = ray.put(shared)
        window, left = _Window(ray), iter(items)
        pending: dict[Any, Any] = {}
        try:
            while True:
                for item in islice(left, max(0, window.size() - len(pending))):
                    pending[task.remote(item, reference)] = item
                if not pending:
                    return
                done, _ = ray.wait(list(pending), num_returns=1)
                yield pending.pop(done[0]), _fetch(ray, done[0])
        finally:
            for unfinished in pending:
                ray.cancel(unfinished, force=True)


class _Window:
    """How many tasks are handed out at a time."""

    def __init__(self, ray: Any) -> None:
        self._ray = ray
        self._size, self._looked = LEAST_AHEAD, -LOOK_EVERY_S

    def size(self) -> int:
        if time.monotonic() - self._looked >= LOOK_EVERY_S:
            cores = int(self._ray.cluster_resources().get("CPU", 0))
            self._size, self._looked = max(LEAST_AHEAD, AHEAD * cores), time.monotonic()
        return self._size


def _fetch(ray: Any, reference: Any) -> Any:
    """A task's result; its own error as if it had been raised here."""
    try:
        return ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None
    except ray.exceptions.RayError as error:
        first = str(error).strip().partition("\n")[0]
        raise EngineError(f"a task lost its worker {RETRIES + 1} times: {first}") from error
