"""Accuracy, recall and IOU of detected cells (paper, equation 10), with StairNet's confidence of a located line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SCORE_THRESHOLD = 0.5  # of the class score, and of the confidence (paper, evaluation metrics)


@dataclass(frozen=True)
class DetectionCounts:
    """Cells counted over any number of frames; counts of several sets add up.

    Attributes:
        true_positives: scored cells that hold a line and locate it with confidence >= 0.5.
        false_positives: scored cells that fail either.
        false_negatives: cells that hold a line and are not scored.
        frames: how many images were counted.
    """

    true_positives: int = 0
    false_positives: int = 0
    false_negatives: int = 0
    frames: int = 0

    def __add__(self, other: DetectionCounts) -> DetectionCounts:
        return DetectionCounts(
            self.true_positives + other.true_positives,
            self.false_positives + other.false_positives,
            self.false_negatives + other.false_negatives,
            self.frames + other.frames,
        )

    @property
    def accuracy(self) -> float:
        """TP / (TP + FP), per cent; 0 when nothing was scored."""
        return _per_cent(self.true_positives, self.true_positives + self.false_positives)

    @property
    def recall(self) -> float:
        """TP / (TP + FN), per cent; 0 when no cell holds a line."""
        return _per_cent(self.true_positives, self.true_positives + self.false_negatives)

    @property
    def iou(self) -> float:
        """TP / (TP + FP + FN), per cent; 0 when there is nothing to find or found."""
        return _per_cent(self.true_positives, self.true_positives + self.false_positives + self.false_negatives)


def _per_cent(part: int, whole: int) -> float:
    return 100.0 * part / whole if whole else 0.0


def endpoint_score(distance: np.ndarray) -> np.ndarray:
    """c(d) = (e^(2(1-d)) - 1) / (e^2 - 1) for d <= 1, else 0; d in cell units (StairNet)."""
    score = np.expm1(2.0 * (1.0 - distance)) / np.expm1(2.0)
    return np.where(distance <= 1.0, score, 0.0)


def line_confidence(predicted: np.ndarray, true: np.ndarray) -> np.ndarray:
    """How well the lines of cells are located.

    Both cells hold two lines (equal when there is one). Each predicted end point is compared with the nearest true one
    of the same side (left with left, right with right, as the representation orders them); a line's confidence is the
    mean of its two ends, a cell's the mean of its two lines.

    Args:
        predicted: (..., 8) coordinates within the cell.
        true: (..., 8).

    Returns:
        (...) float64 in 0..1.
    """
    ends_p = np.asarray(predicted, dtype=np.float64).reshape(*np.shape(predicted)[:-1], 2, 1, 2, 2)  # line, -, side, xy
    ends_t = np.asarray(true, dtype=np.float64).reshape(*np.shape(true)[:-1], 1, 2, 2, 2)  # -, line, side, xy
    distance = np.linalg.norm(ends_p - ends_t, axis=-1).min(axis=-2)  # (..., line, side)
    return endpoint_score(distance).mean(axis=(-2, -1))


def count_cells(
    cls: np.ndarray, loc: np.ndarray, true_cls: np.ndarray, true_loc: np.ndarray, threshold: float = SCORE_THRESHOLD
) -> DetectionCounts:
    """Count a batch of frames.

    Args:
        cls: (B, 32, 16) scores; loc: (B, 32, 16, 8).
        true_cls: (B, 32, 16), 1 where a line is; true_loc: (B, 32, 16, 8).
        threshold: of the class score and of the confidence.

    Returns:
        Counts over the batch. A cell that is scored, holds a line and misses its place is a false positive only.

    Raises:
        ValueError: shapes differ.
    """
    if cls.shape != true_cls.shape or loc.shape != true_loc.shape or loc.shape[:-1] != cls.shape:
        raise ValueError(
            f"shapes differ: cls {cls.shape} and {true_cls.shape}, loc {loc.shape} and {true_loc.shape} "
            "must be (B, rows, columns) and (B, rows, columns, 8)"
        )
    scored, holds = cls >= threshold, true_cls >= 0.5
    located = np.zeros_like(holds)
    both = scored & holds
    located[both] = line_confidence(loc[both], true_loc[both]) >= threshold
    true_positives = int(np.count_nonzero(located))
    return DetectionCounts(
        true_positives=true_positives,
        false_positives=int(np.count_nonzero(scored)) - true_positives,
        false_negatives=int(np.count_nonzero(holds & ~scored)),
        frames=len(cls),
    )
