"""Runs compiled kernels, which release the interpreter lock, on several threads.

Numba's own thread pools do not survive a fork (OpenMP aborts the child), and vector environments fork. A Python
thread pool that belongs to one process id does.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np

SHARES_PER_THREAD = 4

_pools: dict[tuple[int, int], ThreadPoolExecutor] = {}


def default_threads() -> int:
    """Numba's setting: NUMBA_NUM_THREADS, else the number of cores."""
    return int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


def _pool(workers: int) -> ThreadPoolExecutor:
    key = (os.getpid(), workers)
    if key not in _pools:
        _pools[key] = ThreadPoolExecutor(workers, thread_name_prefix="raycast")
    return _pools[key]


def run_rows(work: Callable[[np.ndarray], None], num_rows: int, threads: int | None = None) -> None:
    """Call work on disjoint sets of row indices that together are range(num_rows).

    Args:
        work: takes (k,) int64 row indices; must not depend on how the rows are divided, or on the order of calls.
        num_rows: how many rows there are.
        threads: how many calls run at once; None for `default_threads`.
    """
    count = min(threads or default_threads(), num_rows)
    if count <= 1:
        work(np.arange(num_rows))
        return
    # Interleaved, because the rows of an image are not equally expensive; several a thread, so that one that the
    # system holds up does not hold up the others.
    num_shares = min(SHARES_PER_THREAD * count, num_rows)
    shares = iter([np.arange(start, num_rows, num_shares) for start in range(num_shares)])

    def work_off() -> None:
        for share in shares:  # a list's iterator hands out each item once, whichever thread asks
            work(share)

    pending = [_pool(count - 1).submit(work_off) for _ in range(count - 1)]
    work_off()
    for future in pending:
        if not future.cancel():  # one that has not begun, because its thread does other work, finds nothing left
            future.result()


def later(work: Callable[[], np.ndarray]) -> Callable[[], np.ndarray]:
    """Begin some work in another thread, if there may be two; the function that is returned waits for its result."""
    if default_threads() < 2:
        return work
    return _pool(1).submit(work).result
