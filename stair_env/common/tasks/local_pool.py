"""Tasks in processes of this machine, which start without the caller's threads."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import islice
from typing import Any

THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
AHEAD = 4  # tasks a worker that are handed out: results that nobody has fetched yet take memory

_SHARED: list[Any] = []  # one value in each worker process


def run_in_processes(
    function: Callable[[Any, Any], Any], items: Sequence[Any], workers: int, shared: Any
) -> Iterator[tuple[Any, Any]]:
    """See `run_tasks`."""
    for name in THREAD_VARIABLES:
        os.environ.setdefault(name, "1")  # read by the workers' libraries at load
    workers = min(workers, len(items))
    context = multiprocessing.get_context("spawn")
    left = iter(items)
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_keep, initargs=(shared,)) as pool:
        pending: dict[Future[Any], Any] = {}
        try:
            while True:
                for item in islice(left, AHEAD * workers - len(pending)):
                    pending[pool.submit(_call, function, item)] = item
                if not pending:
                    return
                for future in wait(pending, return_when=FIRST_COMPLETED).done:
                    yield pending.pop(future), future.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _keep(shared: Any) -> None:
    _SHARED[:] = [shared]


def _call(function: Callable[[Any, Any], Any], item: Any) -> Any:
    return function(item, _SHARED[0])
