"""Tables 2, 3 and 6 by one call: train what is missing, tune the classical steps, score all on the same frames."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from perception.backends import Backend, TorchBackend
from perception.baselines.base import LineBackend, LineDetector
from perception.baselines.classical import ClassicalDetector, ClassicalParameters
from perception.baselines.paper_tables import PAPER_TABLES, table_notes, table_rows
from perception.baselines.regions import SCORES, RegionScore, RememberedRegions, choose_least_score
from perception.baselines.roi import RegionFinder, RoiClassicalDetector
from perception.baselines.roi_network import RoiNetwork
from perception.baselines.runs import LEARNED_ROWS, Run, load_run, train_missing
from perception.baselines.stairnet import StairNet, StairNetBackend
from perception.baselines.suite import Progress, validation_sample
from perception.baselines.tuning import TuningResult, tune
from perception.dataset import Sample, StairDataset
from perception.evaluation import Tally, evaluate_detector
from perception.network import StairNetV2
from perception.training import TrainingPreset

TIMED_FRAMES = 20
REMARK = (
    "Learned rows: width {width:g}, from scratch, {epochs} epochs of {frames} frames (the first {small} at half size), "
    "equal in frames, order, schedule and augmentation. The paper trained 200 epochs of 2388 frames and scored its own "
    "set: the order is to be compared, not the height. docs/baselines.md says how each row was made, and why an order "
    "differs."
)
TIME_REMARK = (
    "cpu_ms: processor time of one frame on one core, the median of {count}, all rows by turns in one run; "
    "networks by torch. The paper's milliseconds are of a GPU."
)

TimedDetector = Callable[[np.ndarray, np.ndarray], Any]  # one image pair


@dataclass(frozen=True)
class SuitePlan:
    """What the suite works on.

    Args:
        data: labelled set with `train`, `val` and `test`.
        runs: folder of the trainings.
        preset: of all trainings.
        seeds: of the trainings; the first also seeds the searches.
        width: of all networks.
        tune_frames: validation frames of the searches.
        trials: candidates of each search.
        workers: processes that read frames while training.

    Raises:
        ValueError: no seed.
    """

    data: Path
    runs: Path
    preset: TrainingPreset
    seeds: tuple[int, ...] = (0,)
    width: float = 0.25
    tune_frames: int = 60
    trials: int = 60
    workers: int = 0

    def __post_init__(self) -> None:
        if not self.seeds:
            raise ValueError("seeds=() must hold at least one seed")

    def all_runs(self) -> list[Run]:
        """Every row with every seed: all rows of one seed before the next."""
        return [self.run_of(row, seed) for seed in self.seeds for row in LEARNED_ROWS]

    def run_of(self, row: str, seed: int) -> Run:
        """One training."""
        return Run(row, seed, self.width, self.preset, self.data, self.runs)


@dataclass
class Measured:
    """What the tables are made of.

    Attributes:
        scores: row -> per seed: split -> counts.
        timed: row -> detector of one image pair, of the first seed.
        tuning: what the searches found.
    """

    scores: dict[str, list[Mapping[str, Tally]]] = field(default_factory=dict)
    timed: dict[str, TimedDetector] = field(default_factory=dict)
    tuning: dict[str, Any] = field(default_factory=dict)

    def add(self, row: str, scores: Mapping[str, Tally], detector: TimedDetector) -> None:
        """Add a seed of a row."""
        self.scores.setdefault(row, []).append(scores)
        self.timed.setdefault(row, detector)


def run_suite(plan: SuitePlan, *, progress: Progress, training_bar: bool = True) -> dict[str, dict[str, Any]]:
    """Train, tune, score.

    Args:
        plan: what to work on.
        progress: wraps iterations; takes `description` and, for generators, `total`.
        training_bar: whether the trainer shows its own bar.

    Returns:
        "table2", "table3", "table6" -> JSON-able: rows, notes, and for table 6 what the searches found.

    Raises:
        RunError: the folder holds runs with other settings. DatasetError: the set is incomplete.
    """
    test, validation = StairDataset(plan.data, "test"), StairDataset(plan.data, "val")
    runs = plan.all_runs()
    for _ in progress(
        train_missing(runs, workers=plan.workers, progress=training_bar), total=len(runs), description="training"
    ):
        pass
    measured = Measured()
    score = functools.partial(_score, measured, test, progress)
    frames = validation_sample(validation, plan.seeds[0], plan.tune_frames)
    _measure_classical(plan, frames, measured, score, progress)
    for seed in plan.seeds:
        _measure_networks(plan, seed, frames, measured, score, progress)
    cpu_ms = interleaved_cpu_ms(measured.timed, [test[i] for i in range(min(TIMED_FRAMES, len(test)))])
    return {f"table{table}": _report(table, plan, measured, cpu_ms) for table in PAPER_TABLES}


Score = Callable[[str, Backend, TimedDetector, str], None]


def _score(
    measured: Measured,
    test: StairDataset,
    progress: Progress,
    row: str,
    backend: Backend,
    timed: TimedDetector,
    name: str,
) -> None:
    bar = functools.partial(progress, description=name)
    measured.add(row, evaluate_detector(backend, test, modalities=False, progress=bar), timed)


def _measure_classical(
    plan: SuitePlan, frames: Sequence[Sample], measured: Measured, score: Score, progress: Progress
) -> None:
    bar = functools.partial(progress, description="tuning Gabor + Canny + Hough")
    result = tune(frames, np.random.default_rng(plan.seeds[0]), plan.trials, progress=bar)
    measured.tuning["classical"] = _search_report(result)
    detector = ClassicalDetector(result.parameters)
    score("classical", LineBackend(detector), detector, "Gabor + Canny + Hough")


def _measure_networks(
    plan: SuitePlan, seed: int, frames: Sequence[Sample], measured: Measured, score: Score, progress: Progress
) -> None:
    for row in LEARNED_ROWS:
        network = load_run(plan.run_of(row, seed))
        name = f"{row}, seed {seed}"
        if isinstance(network, RoiNetwork):
            region, result = tuned_within_regions(network, frames, plan, progress)
            measured.tuning[f"roi_classical, seed {seed}"] = {"regions": asdict(region), **_search_report(result)}
            finder = RegionFinder(network, region.least_score)
            detector: LineDetector = RoiClassicalDetector(finder, result.parameters)
            score("roi_classical", LineBackend(detector), detector, name)
            continue
        backend: Backend
        if isinstance(network, StairNet):
            backend = StairNetBackend(network)
        else:
            assert isinstance(network, StairNetV2)
            backend = TorchBackend(network=network)
        score(row, backend, functools.partial(_one_pair, backend), name)


def _one_pair(backend: Backend, rgb: np.ndarray, depth_m: np.ndarray) -> Any:
    return backend(rgb[None], depth_m[None])


def tuned_within_regions(
    network: RoiNetwork, frames: Sequence[Sample], plan: SuitePlan, progress: Progress
) -> tuple[RegionScore, TuningResult]:
    """The least score of a region, then the classical parameters inside regions, both on validation frames."""
    regions = RememberedRegions(RegionFinder(network, min(SCORES)), frames)
    chosen = choose_least_score(regions.found, frames)
    regions.least_score = chosen.least_score

    def make(parameters: ClassicalParameters) -> LineDetector:
        return RoiClassicalDetector(regions, parameters)

    bar = functools.partial(progress, description="tuning inside regions")
    return chosen, tune(frames, np.random.default_rng(plan.seeds[0]), plan.trials, make=make, progress=bar)


def _search_report(result: TuningResult) -> dict[str, Any]:
    return {
        "parameters": asdict(result.parameters),
        "validation_iou": round(result.counts.iou, 2),
        "validation_frames": result.counts.frames,
        "trials": result.trials,
    }


def interleaved_cpu_ms(detectors: Mapping[str, TimedDetector], frames: Sequence[Sample]) -> dict[str, float]:
    """Median processor time of each detector a frame, milliseconds; by turns, so that other work disturbs all alike."""
    times: dict[str, list[float]] = {name: [] for name in detectors}
    for sample in frames:
        for name, detect in detectors.items():
            start = time.process_time()
            detect(sample.rgb, sample.depth_m)
            times[name].append(time.process_time() - start)
    return {name: 1e3 * float(np.median(spent)) for name, spent in times.items()}


def _report(table: int, plan: SuitePlan, measured: Measured, cpu_ms: Mapping[str, float]) -> dict[str, Any]:
    preset = plan.preset
    small = sum(preset.is_small(epoch) for epoch in range(preset.epochs))
    remark = REMARK.format(width=plan.width, epochs=preset.epochs, frames=preset.frames_per_epoch or "all", small=small)
    widths: dict[str, float | None] = dict.fromkeys([*LEARNED_ROWS, "roi_classical"], plan.width)
    report: dict[str, Any] = {
        "rows": table_rows(table, measured.scores, widths, cpu_ms),
        "notes": [*table_notes(table, measured.scores), remark, TIME_REMARK.format(count=TIMED_FRAMES)],
        "training": asdict(preset) | {"seeds": list(plan.seeds)},
    }
    if table == 6:
        report["tuning"] = measured.tuning
    return report
