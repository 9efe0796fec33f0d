"""How well regions are found, and the score from which a found one counts: chosen on validation frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perception.data.stair_dataset import Sample
from perception.reproduction.baselines.region_detector import FindRegions, region_of

SCORES = tuple(round(0.05 * step, 2) for step in range(1, 17))  # candidates for the least score
LEARNED_IOU = 40.0  # per cent: a detector below it has not learned to find stairs; a constant box reaches about 20
RIGHT_OVERLAP = 0.5  # IOU from which a region is right


@dataclass(frozen=True)
class RegionScore:
    """Outcome of the choice.

    Attributes:
        least_score: from which a region counts.
        right: per cent of the frames in which the best region overlaps the true one by half, or that hold no stairs
            and show no region.
        mean_iou: of the best region with the true one, per cent, over frames with stairs; 0 where none counts.
    """

    least_score: float
    right: float
    mean_iou: float


def choose_least_score(found: Sequence[np.ndarray], frames: Sequence[Sample]) -> RegionScore:
    """The least score with which most frames come out right; of equal ones the lowest.

    Args:
        found: per frame (n, 5) regions x1 y1 x2 y2 in pixels and score, the best first, of any score.
        frames: the labelled frames.

    Raises:
        ValueError: no frames, or another number of answers than frames.
    """
    if not frames or len(found) != len(frames):
        raise ValueError(f"{len(found)} answers for {len(frames)} frames: there must be one each, and at least one")
    overlap = np.array([_best_overlap(regions, frame) for regions, frame in zip(found, frames)])
    scores = np.array([regions[0, 4] if len(regions) else 0.0 for regions in found])
    stairs = ~np.isnan(overlap)
    results = []
    for least in SCORES:
        counts = scores >= least
        right = np.where(stairs, counts & (np.nan_to_num(overlap) >= RIGHT_OVERLAP), ~counts)
        reached = (np.nan_to_num(overlap) * counts)[stairs]
        results.append(
            RegionScore(least, 100.0 * float(right.mean()), 100.0 * float(reached.mean() if len(reached) else 0.0))
        )
    return max(results, key=lambda result: (result.right, -result.least_score))


def region_note(name: str, score: RegionScore) -> str:
    """How well regions are found, and whether well enough for the row to say anything about its method."""
    found = f"{name}: regions right in {score.right:.0f} % of the validation frames, mean IOU {score.mean_iou:.0f} %."
    if score.mean_iou >= LEARNED_IOU:
        return found
    return f"{found} The region detector has not learned with this schedule: its row says nothing about the method."


def _best_overlap(regions: np.ndarray, frame: Sample) -> float:
    """IOU of the best region with the truth, 0 when nothing is found; nan in a frame without stairs."""
    true = region_of(frame.lines)
    if true is None:
        return float("nan")
    return box_iou(regions[0, :4], true) if len(regions) else 0.0


def box_iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two boxes (4,) x1 y1 x2 y2."""
    common = np.prod(np.maximum(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0.0))
    union = np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - common
    return float(common / union) if union > 0.0 else 0.0


class RememberedRegions:
    """Regions of given frames, found once: a search looks at the same frames again and again.

    Args:
        find: finds the regions.
        frames: whose images will be asked for.
    """

    def __init__(self, find: FindRegions, frames: Sequence[Sample]) -> None:
        self._frames = tuple(frames)  # kept alive, so that their images stay known by identity
        self.found = [find(frame.rgb) for frame in self._frames]
        self._by_image = {id(frame.rgb): regions for frame, regions in zip(self._frames, self.found)}
        self.least_score = 0.0

    def __call__(self, rgb: np.ndarray) -> np.ndarray:
        """The regions of one of the frames' images from the least score on.

        Raises:
            KeyError: another image.
        """
        regions = self._by_image[id(rgb)]
        return regions[regions[:, 4] >= self.least_score]
