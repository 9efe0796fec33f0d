"""Comparing two ways to do the same work, on a machine that does other things too.

Only ratios of work done in the same minutes hold: rounds alternate between the two, and the row carries the median of
the rounds' ratios.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Timed = Callable[[], float]


@dataclass(frozen=True)
class Row:
    """One comparison.

    Attributes:
        name: what is compared.
        ours, theirs: medians, in `unit`.
        ratio: theirs over ours, the median over rounds: 2 means that ours takes half.
        unit: of ours and theirs.
        rounds: how many pairs were measured.
        target: the ratio asked for, or None.
    """

    name: str
    ours: float
    theirs: float
    ratio: float
    unit: str
    rounds: int
    target: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """JSON-able form."""
        return dataclasses.asdict(self)


def time_pair(
    name: str, ours: Timed, theirs: Timed, *, rounds: int, target: float | None = None, warm_up: int = 1
) -> Row:
    """Measure two functions in turn.

    Args:
        name: of the row.
        ours, theirs: do some work and return the seconds that one unit of it took (see `seconds_per_call`).
        rounds: pairs to measure.
        target: the ratio asked for.
        warm_up: calls of each that are not counted, for compilation and caches.

    Raises:
        ValueError: rounds < 1.
    """
    if rounds < 1:
        raise ValueError(f"rounds={rounds!r} must be >= 1")
    for _ in range(warm_up):
        ours()
        theirs()
    pairs = []
    for index in range(rounds):
        if index % 2:  # whoever goes second finds warmer caches and a hotter processor
            second = theirs()
            pairs.append((ours(), second))
        else:
            first = ours()
            pairs.append((first, theirs()))
    return Row(
        name=name,
        ours=statistics.median(pair[0] for pair in pairs) * 1e3,
        theirs=statistics.median(pair[1] for pair in pairs) * 1e3,
        ratio=statistics.median(pair[1] / pair[0] for pair in pairs),
        unit="ms",
        rounds=rounds,
        target=target,
    )


def seconds_per_call(function: Callable[[], Any], calls: int = 1) -> Timed:
    """A timed version of a function: mean seconds of `calls` calls in a row."""

    def run() -> float:
        start = time.perf_counter()
        for _ in range(calls):
            function()
        return (time.perf_counter() - start) / calls

    return run
