"""Tasks run here, in processes, and anywhere else alike."""

from __future__ import annotations

import os

import numpy as np
import pytest

from stair_env.common.tasks import ENGINES, Engine, run_tasks


def draw(seed: int, offset: float) -> tuple[int, float]:
    return os.getpid(), offset + float(np.random.default_rng(seed).random())


def fail(item: int, shared: None) -> int:
    if item == 3:
        raise ValueError(f"item={item}")
    return item


def die(item: int, shared: None) -> None:
    os._exit(1)


def test_processes_give_what_this_process_gives() -> None:
    here = dict(run_tasks(draw, range(20), shared=10.0))
    there = dict(run_tasks(draw, range(20), Engine(workers=2), shared=10.0))
    assert {item: value for item, (_, value) in here.items()} == {item: value for item, (_, value) in there.items()}
    assert {pid for pid, _ in here.values()} == {os.getpid()} and os.getpid() not in {pid for pid, _ in there.values()}


def test_no_items_start_no_worker() -> None:
    assert not list(run_tasks(die, [], Engine(workers=2)))


def test_the_error_of_a_task_arrives_as_it_is() -> None:
    with pytest.raises(ValueError, match="item=3"):
        list(run_tasks(fail, range(6), Engine(workers=2)))


def test_a_worker_that_dies_ends_the_work() -> None:
    from concurrent.futures.process import BrokenProcessPool

    with pytest.raises(BrokenProcessPool):
        list(run_tasks(die, range(4), Engine(workers=2)))


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"kind": "slurm"}, ", ".join(map(repr, ENGINES))),
        ({"workers": 0}, "workers=0"),
        ({"address": "auto"}, "ray_address"),
    ],
)
def test_a_wrong_engine_is_refused_by_name(arguments: dict, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        Engine(**arguments)
