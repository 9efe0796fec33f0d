"""Running tasks wherever an engine says.

A task is a function of an item and of what all items share. It draws from seeds that its item names and writes no
files, so that it may run anywhere, in any order and more than once; files are written where the results arrive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from stair_env.common.tasks.engine import LOCAL, Engine

Item = TypeVar("Item")
Result = TypeVar("Result")


def run_tasks(
    function: Callable[[Item, Any], Result], items: Sequence[Item], engine: Engine = LOCAL, shared: Any = None
) -> Iterator[tuple[Item, Result]]:
    """Call a function for each item.

    Args:
        function: of (item, shared); importable by name.
        items: one a task; picklable.
        engine: where the tasks run.
        shared: what every task needs; it travels to each process once.

    Yields:
        (item, result) in the order in which they are done.

    Raises:
        EngineError: Ray is not there, or a task lost its worker again and again.
        concurrent.futures.process.BrokenProcessPool: a worker of the local pool died.
    """
    if engine.in_this_process or not items:
        for item in items:
            yield item, function(item, shared)
    elif engine.kind == "local":
        from stair_env.common.tasks.local_pool import run_in_processes

        yield from run_in_processes(function, items, engine.workers, shared)
    else:
        from stair_env.common.tasks.ray_pool import run_on_ray

        yield from run_on_ray(function, items, engine, shared)
