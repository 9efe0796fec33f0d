"""How well the tracked staircase agrees with the true one while a robot walks over it.

The gait walks, no policy: either on the tracked block itself, or on the true one while the tracker looks on. Counted is
every control step from 1.5 m before the first edge until the robot's front hips are past the last one.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from stair_env.common.constants import BACKENDS, SCENE_LIGHTINGS, WALK_DRIVERS, WALKING_DIRECTIONS
from stair_env.common.field_kinds import naming_fields
from stair_env.common.validation import check_choice, check_range
from stair_env.observation import STAIR_FIELDS, StairBlock
from stair_env.robots import get_robot
from stair_env.scene.paper_stairs import PAPER_STAIRS, PaperStair
from stair_env.task.block_error import block_error

NUM_STEPS = 6
RANGE_M = 1.5  # from the front hips to the first edge, from where on the staircase has to be known
COMPARED = {"width": "step_width", "height": "step_height", "next_edge": "edge_distance"}  # error -> field
TARGETS_MM = {"width": 12.0, "height": 8.0, "next_edge": 25.0}
TARGET_VALID = 0.95


@dataclass(frozen=True)
class LiveConfig:
    """Which walks.

    Args:
        drivers: what the gait reads, any of WALK_DRIVERS: the tracked staircase, or the true one.
        flights: walks over each staircase in each direction; day and night in turn.
        width: of StairNetV2.
        backend: of the network, one of `perception.inference.backends.BACKENDS`.
        robot: which robot.
        stairs: which of the paper's staircases, each with six steps.
        workers: processes; 1 walks in this one.

    Raises:
        SpecError: a field is out of range (a ValueError).
    """

    drivers: tuple[str, ...] = WALK_DRIVERS
    flights: int = 4
    width: float = 0.25
    backend: str = "onnx"
    robot: str = "aliengo"
    stairs: tuple[PaperStair, ...] = PAPER_STAIRS
    workers: int = 1

    @naming_fields
    def __post_init__(self) -> None:
        for driver in self.drivers:
            check_choice("driver", driver, WALK_DRIVERS)
        check_choice("backend", self.backend, BACKENDS)
        check_range("flights", self.flights, 1, 10_000)
        check_range("workers", self.workers, 1, 1000)
        get_robot(self.robot)

    @property
    def walks(self) -> int:
        """How many flights will be walked."""
        return len(self.drivers) * len(self.stairs) * len(WALKING_DIRECTIONS) * self.flights


@dataclass
class WalkErrors:
    """Sums over control steps.

    Attributes:
        walks, arrived: flights, and those that ended with the robot on the landing.
        counted: control steps in range of the stairs.
        valid: those of them in which the staircase was known.
        same_edge: those of the valid ones in which tracker and truth speak of the same next edge
            (`stair_env.task.block_error`).
        squared_mm2: by COMPARED; width and height over `valid`, next_edge over `same_edge`.
    """

    walks: int = 0
    arrived: int = 0
    counted: int = 0
    valid: int = 0
    same_edge: int = 0
    squared_mm2: np.ndarray | None = None

    def add(self, block: Sequence[float], truth: dict[str, Any]) -> None:
        """Count a control step.

        Args:
            block: (8,) the tracked staircase, in the order of STAIR_FIELDS.
            truth: `info["truth"]`.
        """
        if truth["valid"] < 0.5 or truth["edge_distance"] > RANGE_M:
            return
        self.counted += 1
        error = block_error(block, truth)
        if error is None:
            return
        self.valid += 1
        self.same_edge += error.same_edge
        distance = error.edge_distance if error.same_edge else 0.0
        errors_mm = 1000.0 * np.array([error.step_width, error.step_height, distance])
        self.squared_mm2 = errors_mm**2 + (0.0 if self.squared_mm2 is None else self.squared_mm2)

    def join(self, other: WalkErrors) -> None:
        """Take another's counts in."""
        for name in ("walks", "arrived", "counted", "valid", "same_edge"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        if other.squared_mm2 is not None:
            self.squared_mm2 = other.squared_mm2 + (0.0 if self.squared_mm2 is None else self.squared_mm2)

    def row(self) -> dict[str, Any]:
        """JSON-able figures; errors are root mean squares in millimetres, None where nothing was tracked."""
        counts = (self.valid, self.valid, self.same_edge)
        sums = self.squared_mm2 if self.squared_mm2 is not None else np.zeros(3)
        rmse = {
            f"{name}_rmse_mm": round(float(np.sqrt(total / count)), 2) if count else None
            for name, total, count in zip(COMPARED, sums, counts)
        }
        return {
            "flights": self.walks,
            "arrived": self.arrived,
            **rmse,
            "valid": round(self.valid / max(self.counted, 1), 4),
            "same_edge": round(self.same_edge / max(self.valid, 1), 4),
            "control_steps": self.counted,
        }


@dataclass(frozen=True)
class _Job:
    """The flights over one staircase in one direction."""

    config: LiveConfig
    driver: str
    stair: PaperStair
    direction: Literal["up", "down"]
    seeds: tuple[int, ...]


def run_walks(config: LiveConfig, seed: int, on_done: Callable[[int], Any] | None = None) -> dict[str, Any]:
    """Walk, and compare.

    Args:
        config: which walks.
        seed: of all of them; both drivers meet the same stairs and surroundings.
        on_done: called with the number of flights just finished.

    Returns:
        JSON-able: `overall` by driver and direction, `rows` for each staircase, the targets.
    """
    jobs = _jobs(config, seed)
    errors: dict[_Job, WalkErrors] = {}
    for job, walked in _run(jobs, config.workers):
        errors[job] = walked
        if on_done is not None:
            on_done(config.flights)
    overall: dict[str, WalkErrors] = {}
    for driver in config.drivers:
        for directions in (("up",), ("down",), WALKING_DIRECTIONS):
            total = overall[f"gait on the {driver} stairs, {' and '.join(directions)}"] = WalkErrors()
            for job in jobs:
                if job.driver == driver and job.direction in directions:
                    total.join(errors[job])
    return {
        "network_width": config.width,
        "backend": config.backend,
        "robot": config.robot,
        "targets_mm": TARGETS_MM,
        "target_valid": TARGET_VALID,
        "overall": {name: total.row() for name, total in overall.items()},
        "rows": [
            {"driver": job.driver, "direction": job.direction, "stair": job.stair.name, **errors[job].row()}
            for job in jobs
        ],
    }


def walk(env: Any, driver: str, seed: int, options: dict[str, Any]) -> WalkErrors:
    """One flight.

    Args:
        env: a "stair_env/StairClimbPerception-v0".
        driver: what the gait reads, one of WALK_DRIVERS.
        seed: of the episode.
        options: of `env.reset`.
    """
    errors = WalkErrors(walks=1)
    action = np.zeros(env.action_space.shape, np.float32)
    observation, info = env.reset(seed=seed, options=options)
    done = False
    while not done:
        if driver == "true":
            env.unwrapped.provide_stair(StairBlock(*(info["truth"][name] for name in STAIR_FIELDS)))
        observation, _, terminated, truncated, info = env.step(action)
        errors.add(observation["stair"].tolist(), info["truth"])
        done = terminated or truncated
    errors.arrived = int(info["is_success"])
    return errors


def _jobs(config: LiveConfig, seed: int) -> list[_Job]:
    jobs = []
    for driver in config.drivers:
        for index, direction in enumerate(WALKING_DIRECTIONS):
            for number, stair in enumerate(config.stairs):
                words = np.random.SeedSequence([seed, index, number]).generate_state(config.flights)
                jobs.append(_Job(config, driver, stair, direction, tuple(map(int, words))))
    return jobs


def _run(jobs: Sequence[_Job], workers: int) -> Iterator[tuple[_Job, WalkErrors]]:
    if workers == 1:
        for job in jobs:
            yield job, _run_job(job)
        return
    with ProcessPoolExecutor(min(workers, len(jobs)), mp_context=multiprocessing.get_context("spawn")) as pool:
        pending = {pool.submit(_run_job, job): job for job in jobs}
        for done in as_completed(pending):
            yield pending[done], done.result()


def _run_job(job: _Job) -> WalkErrors:
    import gymnasium as gym

    import stair_env  # noqa: F401  (registers the environment, also in a worker process)

    total = WalkErrors()
    estimator = {"width": job.config.width, "backend": job.config.backend}
    options = {"stairs": asdict(job.stair.spec(job.direction, NUM_STEPS))}
    for lighting, seeds in zip(SCENE_LIGHTINGS, (job.seeds[::2], job.seeds[1::2])):
        env = gym.make(
            "stair_env/StairClimbPerception-v0",
            disable_env_checker=True,
            robot=job.config.robot,
            lighting=lighting,
            estimator=estimator,
        )
        try:
            for seed in seeds:
                total.join(walk(env, job.driver, seed, options))
        finally:
            env.close()
    return total
