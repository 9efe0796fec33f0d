"""Accuracy, recall and IOU of a detector over a labelled set, by light, view and lost modality (paper, table 5)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from perception.data.label_grid import encode_grid
from perception.data.stair_dataset import Sample, StairDataset
from perception.inference.backends import Backend
from perception.learning.metrics import SCORE_THRESHOLD, DetectionCounts, count_cells

SPLITS = ("all", "day", "night", "ascending", "descending", "negatives", "colour_black", "depth_missing")
BATCH = 8
# Accuracy, recall and IOU in per cent by width and light, on the paper's own photographs (paper, table 5).
PAPER_TABLE_5 = {
    (1.0, "day"): (92.88, 93.34, 87.11),
    (1.0, "night"): (90.78, 92.87, 84.87),
    (0.5, "day"): (92.05, 93.94, 86.89),
    (0.5, "night"): (89.22, 92.91, 83.53),
    (0.25, "day"): (91.06, 92.85, 85.09),
    (0.25, "night"): (88.21, 91.87, 81.82),
}


@dataclass
class Tally:
    """Counts of one split, and how often something was found in frames without any line."""

    counts: DetectionCounts = field(default_factory=DetectionCounts)
    frames_with_cells: int = 0

    def add(self, counts: DetectionCounts) -> None:
        """Count a frame."""
        self.counts += counts
        self.frames_with_cells += counts.true_positives + counts.false_positives > 0


def splits_of(sample: Sample) -> tuple[str, ...]:
    """Which splits a frame as it is belongs to. Frames without any line count as negatives only besides "all"."""
    names = ["all"]
    if sample.lighting in ("day", "night"):
        names.append(sample.lighting)
    names.append({"none": "negatives"}.get(sample.view, sample.view))
    return tuple(name for name in names if name in SPLITS)


def evaluate_detector(
    backend: Backend,
    frames: StairDataset,
    *,
    threshold: float = SCORE_THRESHOLD,
    modalities: bool = True,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> dict[str, Tally]:
    """Run a detector over a set.

    Args:
        backend: the detector.
        frames: the labelled set.
        threshold: of class score and confidence.
        modalities: whether to run each frame again with black colour and without depth.
        progress: wraps the iteration over batches, to show a bar.

    Returns:
        Split -> tally, for the splits that have frames.
    """
    tallies: dict[str, Tally] = {}
    for start in progress(range(0, len(frames), BATCH)):
        samples = [frames[index] for index in range(start, min(start + BATCH, len(frames)))]
        for names, counts in _count(backend, samples, threshold, modalities):
            for name in names:
                tallies.setdefault(name, Tally()).add(counts)
    return {name: tallies[name] for name in SPLITS if name in tallies}


def _count(
    backend: Backend, samples: list[Sample], threshold: float, modalities: bool
) -> Iterator[tuple[tuple[str, ...], DetectionCounts]]:
    """(splits, counts) of each frame, as it is and with a modality lost."""
    rgb = np.stack([sample.rgb for sample in samples])
    depth = np.stack([sample.depth_m for sample in samples])
    grids = [encode_grid(sample.lines) for sample in samples]
    variants: list[tuple[str | None, np.ndarray, np.ndarray]] = [(None, rgb, depth)]
    if modalities:
        variants += [("colour_black", np.zeros_like(rgb), depth), ("depth_missing", rgb, np.zeros_like(depth))]
    for name, colour, distance in variants:
        cls, loc = backend(colour, distance)
        for index, grid in enumerate(grids):
            one = slice(index, index + 1)
            counts = count_cells(cls[one], loc[one], grid.cls[None], grid.loc[None], threshold)
            yield (splits_of(samples[index]) if name is None else (name,)), counts


def as_rows(tallies: dict[str, Tally], model: str, width: float | None) -> list[dict[str, Any]]:
    """One row a split, per cent rounded to 0.01; negatives also say in how many frames something was found."""
    rows = []
    for split, tally in tallies.items():
        counts = tally.counts
        row: dict[str, Any] = {"model": model, "width": width, "split": split}
        row |= {name: round(getattr(counts, name), 2) for name in ("accuracy", "recall", "iou")}
        row["frames"] = counts.frames
        if split == "negatives":
            row["false_frames"] = round(100.0 * tally.frames_with_cells / counts.frames, 2)
        rows.append(row)
    return rows


def beside_paper(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of StairNetV2 with the paper's figures in the rows that table 5 has, too."""
    names = ("paper_accuracy", "paper_recall", "paper_iou")
    return [row | dict(zip(names, PAPER_TABLE_5.get((row["width"], row["split"]), ()))) for row in rows]
