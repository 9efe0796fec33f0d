"""The classical rows of table 6 on our frames: tune on validation frames, score on test frames."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from perception.data.stair_dataset import Sample, StairDataset
from perception.reproduction.baselines.classical import ClassicalDetector, ClassicalParameters
from perception.reproduction.baselines.classical_tuning import TuningResult, tune
from perception.reproduction.baselines.line_detector import LineBackend
from perception.reproduction.table5_detection import as_rows, evaluate_detector

MODEL_NAMES = {"colour": "Gabor + Canny + Hough", "depth": "Gabor + Canny + Hough (depth)"}
# Table 6, all frames of the paper's own set.
PAPER_ROW = {"model": "Gabor + Canny + Hough (paper)", "accuracy": 26.02, "recall": 25.20, "iou": 14.68}
TIMED_FRAMES = 20

Progress = Callable[..., Iterator[Any]]


def evaluate_classical(
    validation: StairDataset,
    test: StairDataset,
    *,
    seed: int,
    tune_frames: int,
    trials: int,
    progress: Progress,
    images: tuple[str, ...] = ("colour",),
) -> dict[str, Any]:
    """Tune and score the classical detector: on colour as in the paper, or on depth.

    Args:
        validation: frames to tune on.
        test: frames to score on.
        seed: of the search and of the choice of validation frames; all images see the same candidates.
        tune_frames: how many validation frames are drawn, at most all.
        trials: candidates of each search.
        progress: wraps iterations; takes `description` and, for generators, `total`.
        images: which image the detector reads, "colour" or "depth"; each is tuned and scored by itself.

    Returns:
        JSON-able: rows (model, width None, split, accuracy, recall, iou, frames), the paper's row, and per model the
        parameters found, their IOU on the validation frames and the milliseconds of processor time a frame took.
    """
    rows: list[dict[str, Any]] = []
    searches: dict[str, Any] = {}
    for image in images:
        name = MODEL_NAMES[image]
        result = _tuned(validation, seed, tune_frames, trials, image, progress)
        detector = ClassicalDetector(result.parameters)
        bar = functools.partial(progress, description=name)
        tallies = evaluate_detector(LineBackend(detector), test, modalities=False, progress=bar)
        rows += as_rows(tallies, name, None)
        searches[name] = {
            "parameters": asdict(result.parameters),
            "validation_iou": round(result.counts.iou, 2),
            "validation_frames": result.counts.frames,
            "trials": result.trials,
            "cpu_ms_per_frame": round(cpu_milliseconds_per_frame(result.parameters, test), 2),
        }
    return {"rows": rows, "paper": [PAPER_ROW], "tuning": searches}


def _tuned(
    validation: StairDataset, seed: int, tune_frames: int, trials: int, image: str, progress: Progress
) -> TuningResult:
    frames = validation_sample(validation, seed, tune_frames)
    bar = functools.partial(progress, description=f"tuning on {image}")
    return tune(frames, np.random.default_rng(seed), trials, image=image, progress=bar)


def validation_sample(validation: StairDataset, seed: int, count: int) -> list[Sample]:
    """Random validation frames to tune on, at most all, in the set's order."""
    chosen = np.random.default_rng([seed, count]).choice(
        len(validation), size=min(count, len(validation)), replace=False
    )
    return [validation[int(index)] for index in np.sort(chosen)]


def cpu_milliseconds_per_frame(parameters: ClassicalParameters, frames: StairDataset) -> float:
    """Median processor time of the detector alone over the first frames of a set, without reading them, milliseconds.

    Processor time, added up over threads, is the same whether or not the machine has other work.
    """
    detector, times = ClassicalDetector(parameters), []
    for index in range(min(TIMED_FRAMES, len(frames))):
        sample = frames[index]
        start = time.process_time()
        detector(sample.rgb, sample.depth_m)
        times.append(time.process_time() - start)
    return 1e3 * float(np.median(times))
