"""Does seeing help? The same episodes with different sources of the stair block, side by side.

Episode i of a cell has the same seed for every source: the same staircase, start and body, so that a difference
between sources is what the robot was told and nothing else.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from policies import pretrained
from policies.evaluate.episode_log import EpisodeLog
from policies.evaluate.flying import Job, Worker, run_jobs
from policies.evaluate.stair_sets import GRID_RISERS_M, GRID_TREADS_M, Cell, make_cells
from policies.make_env import CLIMB_ID, PERCEPTION_ID
from policies.rollout import Episode, Predictor, measurement_summary, run_episode
from policies.statistics import wilson_interval
from stair_env.common.constants import EVALUATION_SOURCES, GRAVITY_M_S2, WALKING_DIRECTIONS
from stair_env.common.field_kinds import naming_fields
from stair_env.common.tasks import Engine
from stair_env.common.validation import check_choice
from stair_env.physics.simulation import CONTROL_DT
from stair_env.robots import DEFAULT_ROBOT, get_robot

OUTCOMES_KEY = "outcomes"  # 1 or 0 for each episode of a cell, which pairs them across evaluations of one seed
CHUNK = 5  # episodes that a worker runs at a time: few enough to share the work evenly


@dataclass(frozen=True)
class Source:
    """One way to fill the stair block, and who acts on it.

    Attributes:
        env_id: environment.
        env_kwargs: its arguments.
        actor: "policy", "blind" (a policy trained without sight) or "gait" (no policy).
        perceived: the block was measured, so its errors are reported.
    """

    env_id: str
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    actor: str = "policy"
    perceived: bool = False


SOURCE_SETUPS: dict[str, Source] = {
    "oracle": Source(CLIMB_ID, {"stair_source": "oracle"}),
    "stairnet": Source(PERCEPTION_ID, perceived=True),
    "noisy": Source(CLIMB_ID, {"stair_source": "noisy"}, perceived=True),
    "blind": Source(CLIMB_ID, {"stair_source": "blind"}, actor="blind"),
    "shuffled": Source(CLIMB_ID, {"stair_source": "shuffled"}),
    "gait": Source(CLIMB_ID, {"stair_source": "oracle"}, actor="gait"),
}


@dataclass(frozen=True)
class EvaluationConfig:
    """What is compared.

    Args:
        policy: shipped name or folder of the policy that sees, or a name in CONTROLS; None where only the gait walks.
        blind_policy: the same for the policy trained without sight.
        robot: which robot; None takes the policies', or aliengo.
        sources: names in EVALUATION_SOURCES.
        stairs: name in STAIR_SETS.
        directions: any of "up", "down".
        risers, treads: of the grid, metres.
        episodes: of each cell and source.
        seed: of all episodes.
        lighting: "day", "night" or "random".
        env_kwargs: further arguments of every environment.
        workers: processes; 1 runs in this one.
        engine: "local" or "ray", which brings the same episodes (`stair_env.common.tasks`).
        ray_address: of a running Ray cluster; None starts one on this machine.
        network_server: with Ray, perceived environments share one network, on a graphics card where there is one.

    Raises:
        ValueError: a wrong value; the message names argument, value and choices.
    """

    policy: str | None = None
    blind_policy: str | None = None
    robot: str | None = None
    sources: Sequence[str] = ("oracle", "gait")
    stairs: str = "paper"
    directions: Sequence[str] = WALKING_DIRECTIONS
    risers: Sequence[float] = GRID_RISERS_M
    treads: Sequence[float] = GRID_TREADS_M
    episodes: int = 10
    seed: int = 0
    lighting: str = "day"
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    workers: int = 1
    engine: str = "local"
    ray_address: str | None = None
    network_server: bool = False

    @naming_fields
    def __post_init__(self) -> None:
        if not self.sources:
            raise ValueError(f"sources is empty, choose from {', '.join(EVALUATION_SOURCES)}")
        for name in self.sources:
            check_choice("source", name, EVALUATION_SOURCES)
        if self.episodes < 1:
            raise ValueError(f"episodes={self.episodes!r} must be >= 1")
        self.runs_on()
        if self.network_server and self.engine != "ray":
            raise ValueError(f"network_server=True is for engine='ray', not {self.engine!r}")
        robot = pretrained.fitting_robot(self.robot, (self.policy, self.blind_policy))
        object.__setattr__(self, "robot", robot)
        self.cells()
        actors = {SOURCE_SETUPS[name].actor for name in self.sources}
        if "policy" in actors and self.policy is None:
            raise ValueError(f"policy=None: sources {', '.join(self.sources)} need a policy")
        if "blind" in actors and self.blind_policy is None:
            raise ValueError("blind_policy=None: source 'blind' needs a policy trained with stair_source='blind'")

    def cells(self) -> list[Cell]:
        """What is climbed, in the order that seeds and records count by."""
        return make_cells(self.stairs, self.directions, self.risers, self.treads, self.robot or DEFAULT_ROBOT)

    def runs_on(self) -> Engine:
        """Where the episodes are flown."""
        return Engine(self.engine, self.workers, self.ray_address)


Records = dict[tuple[str, int], list[Episode]]


def evaluate(config: EvaluationConfig, on_done: Callable[[int], None] | None = None) -> dict[str, Any]:
    """Run all episodes and tabulate them; see `run_all` and `tabulate`."""
    return tabulate(config, run_all(config, on_done))


def run_all(
    config: EvaluationConfig, on_done: Callable[[int], None] | None = None, log: EpisodeLog | None = None
) -> Records:
    """Run all episodes.

    Args:
        config: what to compare.
        on_done: called with the number of episodes just finished.
        log: takes every episode down when it is over; those it knows already are not run again.

    Returns:
        Episodes by source and index of the cell, in the order of their seeds.

    Raises:
        ValueError: a policy cannot be loaded or does not fit.
        concurrent.futures.process.BrokenProcessPool: a worker died.
        stair_env.common.tasks.EngineError: Ray is not to be had, or an episode loses its workers again and again.
    """
    cells = config.cells()
    jobs = plan_jobs(config, cells)
    found = dict(log.episodes) if log else {}
    left = [
        dataclasses.replace(job, seeds=seeds)
        for job in jobs
        if (seeds := tuple(seed for seed in job.seeds if job.key(seed) not in found))
    ]
    if on_done and len(left) < len(jobs):
        on_done(sum(len(job.seeds) for job in jobs) - sum(len(job.seeds) for job in left))
    for job, episodes in run_jobs(left, config.runs_on(), config.network_server):
        found.update((job.key(episode.seed), episode) for episode in episodes)
        if log:
            log.add(job.source, job.policy, job.cell_index, episodes)
        if on_done:
            on_done(len(episodes))
    records: dict[tuple[str, int], list[Episode]] = {
        (source, index): [] for source in config.sources for index in range(len(cells))
    }
    for job in jobs:
        records[job.source, job.cell_index].extend(found[job.key(seed)] for seed in job.seeds)
    return records


def episode_settings(config: EvaluationConfig) -> dict[str, Any]:
    """What an episode depends on beside source, policy, cell and seed, of which more may follow later."""
    names = ("robot", "stairs", "directions", "risers", "treads", "seed", "lighting", "env_kwargs")
    return {name: getattr(config, name) for name in names}


def tabulate(config: EvaluationConfig, records: Records) -> dict[str, Any]:
    """`cells` and `overall` as `stair-env evaluate --json` writes them."""
    cells = config.cells()
    mass = get_robot(config.robot or DEFAULT_ROBOT).mass
    rows = [
        {
            **_describe_cell(source, cells[index]),
            **summarise(episodes, SOURCE_SETUPS[source].perceived, mass),
            OUTCOMES_KEY: "".join(str(int(episode.success)) for episode in episodes),
        }
        for (source, index), episodes in records.items()
    ]
    overall = {}
    for source in config.sources:
        everything = [episode for index in range(len(cells)) for episode in records[source, index]]
        overall[source] = summarise(everything, SOURCE_SETUPS[source].perceived, mass)
    return {"cells": rows, "overall": overall}


def film_chosen(config: EvaluationConfig, records: Records, folder: Path | str) -> list[Path]:
    """Film, for each source, the first episode that failed and the first that succeeded.

    Args:
        config: of the evaluation.
        records: what `run_all` returned.
        folder: gets `SOURCE_success.mp4` and `SOURCE_failure.mp4`.

    Returns:
        The videos.
    """
    from policies.report.film import Film, open_video

    videos = []
    for env, policy, job, seed, name, title in _chosen(config, records, {"render_mode": "rgb_array"}):
        videos.append(Path(folder) / f"{name}.mp4")
        with open_video(videos[-1]) as writer:
            film = Film(env, writer, title)
            film.finish(run_episode(env, policy, seed, options=job.options, on_step=film.add))
    return videos


def log_chosen(config: EvaluationConfig, records: Records, folder: Path | str) -> list[Path]:
    """The same episodes as `film_chosen`, for the Rerun viewer: `SOURCE_success.rrd` and `SOURCE_failure.rrd`."""
    from policies.report.flight_log import FlightLog, open_flights

    paths = []
    for env, policy, job, seed, name, _ in _chosen(config, records, {}):
        paths.append(Path(folder) / f"{name}.rrd")
        with open_flights(paths[-1]) as opened:
            run_episode(env, policy, seed, options=job.options, on_step=FlightLog(opened, env).add)
    return paths


def _chosen(
    config: EvaluationConfig, records: Records, env_kwargs: Mapping[str, Any]
) -> Iterator[tuple[gym.Env, Predictor, Job, int, str, str]]:
    """Of each source the first episode that failed and the first that succeeded: what flies it, its name and title."""
    cells, named = config.cells(), set()
    with contextlib.closing(Worker()) as worker:
        for job in plan_jobs(config, cells):
            for seed in job.seeds:
                episode = next(e for e in records[job.source, job.cell_index] if e.seed == seed)
                name = f"{job.source}_{'success' if episode.success else 'failure'}"
                if name in named:
                    continue
                named.add(name)
                shown = dataclasses.replace(job, env_kwargs={**job.env_kwargs, **env_kwargs})
                cell = cells[job.cell_index]
                title = " ".join(filter(None, [f"{job.source},", cell.direction, cell.name]))
                yield *worker.prepare(shown), job, seed, name, title


def plan_jobs(config: EvaluationConfig, cells: Sequence[Cell]) -> list[Job]:
    """All work in chunks; the slow sources first, so that no worker is left with them at the end."""
    actors = {"policy": config.policy, "blind": config.blind_policy, "gait": None}
    size = CHUNK if config.engine == "local" else 1  # on a cluster a lost worker costs one episode
    jobs = []
    for name in sorted(config.sources, key=lambda name: SOURCE_SETUPS[name].env_id != PERCEPTION_ID):
        source = SOURCE_SETUPS[name]
        common = {**_interface(actors[source.actor]), "robot": config.robot, "lighting": config.lighting}
        common |= {**config.env_kwargs, **source.env_kwargs}
        for index, cell in enumerate(cells):
            seeds = episode_seeds(config.seed, index, config.episodes)
            for start in range(0, len(seeds), size):
                chunk = tuple(seeds[start : start + size])
                kwargs = {**common, **cell.env_kwargs}
                jobs.append(Job(name, index, source.env_id, kwargs, cell.options, actors[source.actor], chunk))
    return jobs


def episode_seeds(seed: int, cell_index: int, episodes: int) -> list[int]:
    """Seeds of a cell's episodes, the same for every source."""
    return [int(word) for word in np.random.SeedSequence([seed, cell_index]).generate_state(episodes)]


def summarise(episodes: Sequence[Episode], perceived: bool, mass_kg: float) -> dict[str, Any]:
    """Figures of some episodes; errors of the measurement only where there is one."""
    successes = sum(episode.success for episode in episodes)
    climbed = sum(episode.steps_climbed for episode in episodes)
    walked = sum(max(episode.distance_m, 0.0) for episode in episodes)
    times = [episode.control_steps * CONTROL_DT for episode in episodes if episode.success]
    summary: dict[str, Any] = {
        "episodes": len(episodes),
        "successes": successes,
        "success_rate": successes / len(episodes) if episodes else None,
        "ci95": list(wilson_interval(successes, len(episodes))),
        "steps_climbed_fraction": climbed / max(sum(episode.num_steps for episode in episodes), 1),
        "riser_hits_per_step": sum(episode.riser_hits for episode in episodes) / max(climbed, 1),
        "time_s": float(np.mean(times)) if times else None,
        "cost_of_transport": sum(episode.energy_j for episode in episodes)
        / (mass_kg * GRAVITY_M_S2 * max(walked, 1e-6)),
        "terminations": dict(sorted(Counter(episode.termination for episode in episodes).items())),
    }
    if perceived:
        summary |= measurement_summary(episodes)
    return summary


def _interface(policy: str | None) -> dict[str, Any]:
    """Arguments of the environment without which a policy does not fit."""
    return {} if policy is None else pretrained.interface(policy)


def _describe_cell(source: str, cell: Cell) -> dict[str, Any]:
    named = {"stair": cell.name} if cell.name else {}
    if cell.condition:
        named["condition"] = cell.condition
    size = {"riser_height": cell.riser_height, "tread_depth": cell.tread_depth, "num_steps": cell.num_steps}
    return {"source": source, "direction": cell.direction, **named, **size}


def count_episodes(config: EvaluationConfig) -> int:
    """How many episodes `evaluate` will run."""
    return len(config.cells()) * config.episodes * len(config.sources)
