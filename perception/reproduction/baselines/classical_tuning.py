"""Random search for the parameters of the classical detector on validation frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from perception.data.label_grid import encode_grid
from perception.data.stair_dataset import Sample
from perception.learning.metrics import DetectionCounts
from perception.reproduction.baselines.classical import ClassicalDetector, ClassicalParameters
from perception.reproduction.baselines.line_detector import LineDetector, score_lines

HEAT_SHARE = 6  # the first round sees every sixth frame, and every sixth candidate goes on to the second

# Bounds of the search: values are drawn log-uniformly. Wide enough that the best of a search lies inside.
SEARCH_RANGES = {
    "wavelength_px": (4.0, 20.0),
    "sigma_ratio": (0.25, 0.7),
    "elongation": (0.7, 4.0),
    "least_deviation": (0.1, 4.0),
    "canny_high": (60.0, 500.0),
    "votes": (15.0, 120.0),
    "min_length_px": (20.0, 160.0),
    "max_gap_px": (3.0, 40.0),
    "max_slope_deg": (10.0, 45.0),
    "merge_px": (2.0, 14.0),
}
SPREADS_DEG = (0.0, 15.0)
LOW_TO_HIGH = (0.3, 0.7)  # range of canny_low / canny_high


@dataclass(frozen=True)
class TuningResult:
    """Outcome of a search.

    Attributes:
        parameters: the best found.
        counts: of the best over all frames of the search.
        trials: how many candidates were tried.
    """

    parameters: ClassicalParameters
    counts: DetectionCounts
    trials: int


def draw_parameters(rng: np.random.Generator, image: str = "colour") -> ClassicalParameters:
    """One candidate.

    Args:
        rng: source of randomness.
        image: which image the detector reads.
    """
    values: dict[str, Any] = {
        name: float(np.exp(rng.uniform(*np.log(bounds)))) for name, bounds in SEARCH_RANGES.items()
    }
    values["canny_low"] = values["canny_high"] * float(rng.uniform(*LOW_TO_HIGH))
    values["spread_deg"] = float(rng.choice(SPREADS_DEG))
    values["votes"] = round(values["votes"])
    return ClassicalParameters(image=image, **values)


def tune(
    frames: Sequence[Sample],
    rng: np.random.Generator,
    trials: int,
    *,
    image: str = "colour",
    make: Callable[[ClassicalParameters], LineDetector] = ClassicalDetector,
    progress: Callable[[Iterable[ClassicalParameters]], Iterable[ClassicalParameters]] = iter,
) -> TuningResult:
    """Find the parameters with the largest IOU.

    Two rounds: all candidates (the defaults among them) on a sixth of the frames, the best sixth of them on all.

    Args:
        frames: labelled validation frames.
        rng: source of the candidates.
        trials: number of candidates, at least 1.
        image: "colour" or "depth".
        make: the detector with a candidate's parameters.
        progress: wraps the iteration over the first round, to show a bar.

    Raises:
        ValueError: no frames, or trials below 1.
    """
    if trials < 1 or not frames:
        raise ValueError(f"trials={trials!r} and the number of frames, {len(frames)}, must both be at least 1")
    candidates = [ClassicalParameters(image=image), *(draw_parameters(rng, image) for _ in range(trials - 1))]
    grids = [encode_grid(frame.lines) for frame in frames]
    heat = slice(None, None, HEAT_SHARE)
    first = (score_lines(make(c), frames[heat], grids[heat]).iou for c in progress(candidates))
    ranked = sorted((-iou, i) for i, iou in enumerate(first))
    finalists = [candidates[i] for _, i in ranked[: -(-trials // HEAT_SHARE)]]
    scores = [score_lines(make(candidate), frames, grids) for candidate in finalists]
    best = max(range(len(finalists)), key=lambda i: scores[i].iou)
    return TuningResult(finalists[best], scores[best], trials)
