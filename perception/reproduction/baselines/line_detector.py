"""One interface for all opponents of StairNetV2, and the way from their lines to the network's grid."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import numpy as np

from perception.data.label_grid import LabelGrid, decode_grid, encode_grid
from perception.data.stair_dataset import Sample
from perception.inference.backends import Backend, check_batch
from perception.learning.metrics import SCORE_THRESHOLD, DetectionCounts, count_cells


class LineDetector(Protocol):
    """Finds stair lines in one image pair."""

    def __call__(self, rgb: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
        """Detect.

        Args:
            rgb: uint8 (512, 512, 3).
            depth_m: float32 (512, 512), metres along the optical axis, 0 = no reading.

        Returns:
            (n, 4) float64 x1 y1 x2 y2, pixels of the 512 x 512 image, left end first.
        """


def lines_to_grid(lines: np.ndarray) -> LabelGrid:
    """The 32 x 16 grid of found lines, cut by the encoder that also cuts the labels.

    Args:
        lines: (n, 4) pixels of the 512 x 512 image; n may be 0.

    Returns:
        Grid whose class score is 1 in cells that hold a line: a detector of lines states no probability.
    """
    return encode_grid(np.asarray(lines, dtype=np.float64).reshape(-1, 4))


class LineBackend:
    """A line detector in the place of the network (`perception.inference.backends.Backend`), for the same evaluation.

    Args:
        detector: what finds the lines.
    """

    def __init__(self, detector: LineDetector) -> None:
        self.detector = detector

    def __call__(self, rgb: np.ndarray, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Detect on a batch.

        Args:
            rgb: uint8 (B, 512, 512, 3).
            depth_m: float32 (B, 512, 512), metres, 0 = no reading.

        Returns:
            cls: float32 (B, 32, 16), 1 where a cell holds a line, else 0; loc: float32 (B, 32, 16, 8) in 0..1.

        Raises:
            ValueError: a wrong shape or dtype.
        """
        check_batch(rgb, depth_m)
        grids = [lines_to_grid(self.detector(colour, depth)) for colour, depth in zip(rgb, depth_m)]
        empty = lines_to_grid(np.zeros((0, 4)))
        cls = np.stack([grid.cls for grid in grids]) if grids else np.zeros((0, *empty.cls.shape), np.float32)
        loc = np.stack([grid.loc for grid in grids]) if grids else np.zeros((0, *empty.loc.shape), np.float32)
        return cls, loc


class GridDetector:
    """A network in the place of a line detector: the lines of its scored cells.

    Args:
        backend: the network behind numpy.
        threshold: least class score of a cell.
    """

    def __init__(self, backend: Backend, threshold: float = SCORE_THRESHOLD) -> None:
        self.backend, self.threshold = backend, threshold

    def __call__(self, rgb: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
        """Detect; see `LineDetector`. A cell gives two segments, which nearly coincide where it holds one line."""
        cls, loc = self.backend(rgb[None], depth_m[None])
        return decode_grid(cls[0], loc[0], self.threshold).reshape(-1, 4)


def score_lines(
    detector: LineDetector, frames: Iterable[Sample], true_grids: Iterable[LabelGrid] | None = None
) -> DetectionCounts:
    """Cells counted over frames (equation 10), as for the network.

    Args:
        detector: what finds the lines.
        frames: labelled frames.
        true_grids: the frames' encoded labels, where they are at hand; encoded here otherwise.
    """
    counts = DetectionCounts()
    frames = list(frames)
    truths = true_grids if true_grids is not None else (encode_grid(frame.lines) for frame in frames)
    for frame, true in zip(frames, truths):
        found = lines_to_grid(detector(frame.rgb, frame.depth_m))
        counts += count_cells(found.cls[None], found.loc[None], true.cls[None], true.loc[None])
    return counts
