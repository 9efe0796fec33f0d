"""Paired timing."""

from __future__ import annotations

import time

import pytest

from stair_env_cli.bench.timing import seconds_per_call, time_pair


def test_ratio_is_theirs_over_ours_and_robust_to_a_hiccup() -> None:
    ours, theirs = iter([9.0, 1.0, 1.0, 50.0, 1.0, 1.0]), iter([9.0, 2.0, 2.0, 2.0, 2.0, 2.0])
    row = time_pair("x", lambda: next(ours), lambda: next(theirs), rounds=5, target=1.5)
    assert (row.ratio, row.ours, row.theirs, row.unit) == (2.0, 1000.0, 2000.0, "ms")


def test_rounds_alternate_the_order() -> None:
    order: list[str] = []

    def log(name: str) -> float:
        order.append(name)
        return 1.0

    time_pair("x", lambda: log("o"), lambda: log("t"), rounds=4, warm_up=0)
    assert "".join(order) == "ottootto"


def test_no_rounds_are_refused() -> None:
    with pytest.raises(ValueError, match="rounds=0"):
        time_pair("x", lambda: 1.0, lambda: 1.0, rounds=0)


def test_seconds_are_per_call() -> None:
    assert 0.002 <= seconds_per_call(lambda: time.sleep(0.002), calls=3)() < 0.02
