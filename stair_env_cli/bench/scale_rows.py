"""How flights speed up with workers: the same flights on one worker and on several, in turn.

Counted from the moment at which every worker has flown once, so that starting processes and building environments,
which a long evaluation does once, is left out.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Sequence

from stair_env.common.tasks import Engine
from stair_env_cli.bench.timing import Row

FLIGHTS = 24  # of each measurement and worker, at least
ROUNDS = 3


def scale_rows(workers: Sequence[int], engine: str, address: str | None, rounds: int = ROUNDS) -> list[Row]:
    """A row for each number of workers: seconds for 1,000 control steps, against those of one worker.

    Args:
        workers: how many.
        engine: "local" or "ray".
        address: of a Ray cluster, which takes as many flights at a time as it has cores, whatever `workers` says.
        rounds: pairs of measurements.
    """
    found: dict[int, list[tuple[float, float]]] = {count: [] for count in workers}
    for _ in range(rounds):
        for count in workers:
            ours = seconds_per_1000_steps(Engine(engine, count, address))
            theirs = seconds_per_1000_steps(Engine("local", 1))
            found[count].append((ours, theirs))
    return [
        Row(
            name=f"1,000 control steps of flights, {count} workers ({engine})",
            ours=statistics.median(ours for ours, _ in pairs),
            theirs=statistics.median(theirs for _, theirs in pairs),
            ratio=statistics.median(theirs / ours for ours, theirs in pairs),
            unit="s",
            rounds=rounds,
        )
        for count, pairs in found.items()
    ]


def seconds_per_1000_steps(engine: Engine, flights: int | None = None) -> float:
    """Fly the gait up and down random stairs.

    Args:
        engine: where.
        flights: how many, more than workers; None takes FLIGHTS a worker.
    """
    from policies.evaluate.evaluation import EvaluationConfig, plan_jobs
    from policies.evaluate.flying import run_jobs

    flights = flights or FLIGHTS * engine.workers
    config = EvaluationConfig(
        sources=("gait",),
        stairs="random",
        directions=("up",),
        episodes=flights,
        workers=engine.workers,
        engine=engine.kind,
        ray_address=engine.address,
    )
    planned = plan_jobs(config, config.cells())
    jobs = [dataclasses.replace(job, seeds=(seed,)) for job in planned for seed in job.seeds]  # a result each
    ends, steps = [], []
    for _, episodes in run_jobs(jobs, engine):
        ends.append(time.perf_counter())
        steps.append(sum(episode.control_steps for episode in episodes))
    skipped = min(engine.workers, len(ends) - 1)  # the first results: workers that were still starting
    return 1000.0 * (ends[-1] - ends[skipped - 1]) / sum(steps[skipped:])
