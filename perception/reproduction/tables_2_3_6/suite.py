"""Tables 2, 3 and 6 by one call: train what is missing, tune the classical steps, score all on the same frames."""

from __future__ import annotations

import functools
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from perception.data.stair_dataset import Sample, StairDataset
from perception.inference.backends import Backend, TorchBackend
from perception.learning.metrics import DetectionCounts
from perception.learning.presets import TrainingPreset
from perception.network import StairNetV2
from perception.reproduction.baselines.classical import ClassicalDetector, ClassicalParameters
from perception.reproduction.baselines.classical_tuning import TuningResult, tune
from perception.reproduction.baselines.line_detector import GridDetector, LineBackend, LineDetector
from perception.reproduction.baselines.region_detector import RegionFinder, RoiClassicalDetector
from perception.reproduction.baselines.region_network import RoiNetwork
from perception.reproduction.baselines.region_score import (
    SCORES,
    RegionScore,
    RememberedRegions,
    choose_least_score,
    region_note,
)
from perception.reproduction.baselines.stairnet import StairNet, StairNetBackend
from perception.reproduction.table5_detection import Tally, evaluate_detector
from perception.reproduction.tables_2_3_6.classical_suite import Progress, validation_sample
from perception.reproduction.tables_2_3_6.figure7 import compare, exemplary_frames
from perception.reproduction.tables_2_3_6.runs import LEARNED_ROWS, Run, load_run, train_missing
from perception.reproduction.tables_2_3_6.tables import PAPER_TABLES, Scores, close_rows, table_notes, table_rows
from stair_env.common.files import atomic_path, read_json_object

TIMED_FRAMES = 20
SCORES_FILE = "test_scores.json"
REGION_SIZE_PX = 256  # of the frames that the region detector is trained on and sees
REMARK = (
    "Learned rows: width {width:g}, from scratch, {epochs} epochs of {frames} frames (the first {small} at half size, "
    "of the region detector all), equal in frames, order, schedule and augmentation. The paper trained 200 epochs of "
    "2388 frames and scored its own set: the order is to be compared, not the height. docs/baselines.md says how each "
    "row was made, and why an order differs."
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
        close_seeds: further seeds of rows that lie less than a point from another of their table.
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
    close_seeds: tuple[int, ...] = (0, 1, 2)
    width: float = 0.25
    tune_frames: int = 200
    trials: int = 120
    workers: int = 0

    def __post_init__(self) -> None:
        if not self.seeds:
            raise ValueError("seeds=() must hold at least one seed")

    def all_runs(self) -> list[Run]:
        """Every row with every seed: all rows of one seed before the next."""
        return [self.run_of(row, seed) for seed in self.seeds for row in LEARNED_ROWS]

    def close_runs(self, scores: Scores) -> list[Run]:
        """The further runs of rows that lie close together."""
        rows = ["roi" if row == "roi_classical" else row for row in close_rows(scores)]
        return [self.run_of(row, seed) for seed in self.close_seeds if seed not in self.seeds for row in rows]

    def run_of(self, row: str, seed: int) -> Run:
        """One training."""
        return Run(row, seed, self.width, self.preset, self.data, self.runs)


class PaperSuite:
    """Trains, tunes and scores the rows of tables 2, 3 and 6.

    Args:
        plan: what to work on.
        progress: wraps iterations; takes `description` and, for generators, `total`.

    Raises:
        DatasetError: the set is incomplete.
    """

    def __init__(self, plan: SuitePlan, progress: Progress) -> None:
        self.plan, self._progress = plan, progress
        self._test = StairDataset(plan.data, "test")
        validation = StairDataset(plan.data, "val")
        self._tuning_frames = validation_sample(validation, plan.seeds[0], plan.tune_frames)
        self.scores: dict[str, list[Mapping[str, Tally]]] = {}  # row -> per seed: split -> counts
        self.detectors: dict[str, LineDetector] = {}  # row -> detector of the first seed
        self._timed: dict[str, TimedDetector] = {}
        self.tuning: dict[str, Any] = {}  # what the searches found
        self._region_notes: list[str] = []

    def measure(self, *, train: bool = True, bar: bool = True) -> None:
        """Train what is missing, going on where it was killed, then tune and score every row that is trained.

        Args:
            train: if not, the tables say what is not trained.
            bar: whether the trainer shows its own bar.

        Raises:
            RunError: the folder holds runs with other settings.
        """
        self._measure_classical()
        self._measure_networks(self.plan.all_runs(), train, bar)
        self._measure_networks(self.plan.close_runs(self.scores), train, bar)

    def _measure_networks(self, runs: Sequence[Run], train: bool, bar: bool) -> None:
        if train:
            trained = train_missing(runs, workers=self.plan.workers, progress=bar)
            for _ in self._progress(trained, total=len(runs), description="training"):
                pass
        for run in runs:
            if run.is_done:
                run.check_settings()
                self._measure_network(run)

    def tables(self) -> dict[str, dict[str, Any]]:
        """ "table2", "table3", "table6" -> JSON-able: rows, notes, and for table 6 what the searches found."""
        frames = [self._test[index] for index in range(min(TIMED_FRAMES, len(self._test)))]
        cpu_ms = interleaved_cpu_ms(self._timed, frames)
        reports = {f"table{table}": _report(table, self.plan, self.scores, cpu_ms) for table in PAPER_TABLES}
        reports["table6"]["tuning"] = self.tuning
        reports["table6"]["notes"] += self._region_notes
        return reports

    def picture(self) -> np.ndarray:
        """What the methods of table 6 find on a few test frames, uint8 (H, W, 3)."""
        shown = {row.model: self.detectors[row.row] for row in PAPER_TABLES[6] if row.row in self.detectors}
        regions = {name: found.find for name, found in shown.items() if isinstance(found, RoiClassicalDetector)}
        return compare(exemplary_frames(self._test), shown, regions)

    def _measure_classical(self) -> None:
        bar = functools.partial(self._progress, description="tuning Gabor + Canny + Hough")
        result = tune(self._tuning_frames, np.random.default_rng(self.plan.seeds[0]), self.plan.trials, progress=bar)
        self.tuning["classical"] = _search_report(result)
        detector = ClassicalDetector(result.parameters)
        self._add("classical", self._score(LineBackend(detector), "Gabor + Canny + Hough"), detector, detector)

    def _measure_network(self, run: Run) -> None:
        network = load_run(run)
        name = f"{run.row}, seed {run.seed}"
        if isinstance(network, RoiNetwork):
            detector, chosen, found = tuned_within_regions(network, self._tuning_frames, self.plan, self._progress)
            self.tuning[f"roi_classical, seed {run.seed}"] = found
            self._region_notes.append(region_note(name, chosen))
            self._add("roi_classical", self._score(LineBackend(detector), name), detector, detector)
            return
        backend: Backend
        if isinstance(network, StairNet):
            backend = StairNetBackend(network)
        else:
            assert isinstance(network, StairNetV2)
            backend = TorchBackend(network=network)
        scores = self._remembered_scores(run, backend, name)
        self._add(run.row, scores, GridDetector(backend), functools.partial(_one_pair, backend))

    def _add(self, row: str, scores: Mapping[str, Tally], detector: LineDetector, timed: TimedDetector) -> None:
        self.scores.setdefault(row, []).append(scores)
        self.detectors.setdefault(row, detector)
        self._timed.setdefault(row, timed)

    def _score(self, backend: Backend, name: str) -> dict[str, Tally]:
        bar = functools.partial(self._progress, description=name)
        return evaluate_detector(backend, self._test, modalities=False, progress=bar)

    def _remembered_scores(self, run: Run, backend: Backend, name: str) -> dict[str, Tally]:
        """Scores of a network that has nothing left to tune, kept beside its weights: scoring takes minutes."""
        path, test = run.path / SCORES_FILE, self._test.folder
        key = {"folder": str(test.resolve()), "frames": len(self._test)}
        if path.is_file():
            there = read_json_object(path)
            if there["set"] == key:
                return {split: Tally(DetectionCounts(*counts)) for split, counts in there["counts"].items()}
        scores = self._score(backend, name)
        counts = {split: list(astuple(tally.counts)) for split, tally in scores.items()}
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps({"set": key, "counts": counts}) + "\n", encoding="utf-8")
        return scores


def _one_pair(backend: Backend, rgb: np.ndarray, depth_m: np.ndarray) -> Any:
    return backend(rgb[None], depth_m[None])


def tuned_within_regions(
    network: RoiNetwork, frames: Sequence[Sample], plan: SuitePlan, progress: Progress
) -> tuple[RoiClassicalDetector, RegionScore, dict[str, Any]]:
    """The least score of regions, then the classical parameters inside them, both on validation frames.

    Returns:
        The detector, how well regions are found, and what was found, JSON-able.
    """
    regions = RememberedRegions(RegionFinder(network, min(SCORES), REGION_SIZE_PX), frames)
    chosen = choose_least_score(regions.found, frames)
    regions.least_score = chosen.least_score

    def make(parameters: ClassicalParameters) -> LineDetector:
        return RoiClassicalDetector(regions, parameters)

    bar = functools.partial(progress, description="tuning inside regions")
    result = tune(frames, np.random.default_rng(plan.seeds[0]), plan.trials, make=make, progress=bar)
    report = {"regions": asdict(chosen) | {"size_px": REGION_SIZE_PX}, **_search_report(result)}
    finder = RegionFinder(network, chosen.least_score, REGION_SIZE_PX)
    detector = RoiClassicalDetector(finder, result.parameters)
    return detector, chosen, report


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


def _report(table: int, plan: SuitePlan, scores: Scores, cpu_ms: Mapping[str, float]) -> dict[str, Any]:
    preset = plan.preset
    small = sum(preset.is_small(epoch) for epoch in range(preset.epochs))
    remark = REMARK.format(width=plan.width, epochs=preset.epochs, frames=preset.frames_per_epoch or "all", small=small)
    widths: dict[str, float | None] = dict.fromkeys([*LEARNED_ROWS, "roi_classical"], plan.width)
    return {
        "rows": table_rows(table, scores, widths, cpu_ms),
        "notes": [*table_notes(table, scores), remark, TIME_REMARK.format(count=TIMED_FRAMES)],
        "training": asdict(preset)
        | {"seeds": list(plan.seeds), "close_seeds": list(plan.close_seeds), "data": plan.data.name},
    }
