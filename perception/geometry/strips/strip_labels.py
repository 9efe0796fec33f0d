"""Which strip between two stair lines is a tread and which a riser.

A thin strip far away fits both. What settles it is the order of the faces: a tread and a riser that follow each other
meet in the line between them, treads that follow each other go down, risers that follow each other go away from the
camera. The cheapest consistent sequence is found by dynamic programming (Viterbi).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

UNKNOWN, TREAD, RISER = 0, 1, 2

SCATTER_COST = 1.5  # per standard deviation of the median residual
OUTLIER_COST = 8.0  # when no point fits: a strip of two faces has at least a third of its points off
UNKNOWN_COST = 4.0  # of leaving a strip unexplained: a fit with half its points off costs more
MEETING_LIMIT = 6.0  # largest cost of two faces that do not meet in their line
MEETING_FLOOR_M = 0.008
IMPOSSIBLE_COST = 5.0  # treads that go up without a riser, risers that come nearer
STRIPE_COST = 0.3  # a line within one and the same face
HIDDEN_TREAD_COST = 3.0  # riser behind riser although the tread between them would be seen
SEEN_TREAD_RAD = 0.015  # angle from which a tread between two risers has lines of its own (9 px at f = 615 px)
SAME_FACE_M = 0.05  # the paper's omega


@dataclass(frozen=True)
class Candidate:
    """Strips fitted as one kind of face.

    Attributes:
        value: (K,) height of the tread or forward distance of the riser, metres.
        std: (K,) of the value, metres.
        scatter: (K,) median residual, standard deviations.
        inliers: (K,) share of the points that fit.
    """

    value: np.ndarray
    std: np.ndarray
    scatter: np.ndarray
    inliers: np.ndarray

    def cost(self) -> np.ndarray:
        """(K,) how badly the points fit."""
        return SCATTER_COST * self.scatter + OUTLIER_COST * (1.0 - self.inliers)


def choose_kinds(
    tread: Candidate, riser: Candidate, enough: np.ndarray, line_slope: np.ndarray, line_slope_std: np.ndarray
) -> np.ndarray:
    """The kind of every strip, nearest first.

    Args:
        tread, riser: the same K strips explained either way.
        enough: (K,) whether a strip has enough points to be explained at all.
        line_slope: (K - 1,) height per forward metre at which the camera sees the line between neighbours.
        line_slope_std: (K - 1,) its standard deviation.

    Returns:
        (K,) UNKNOWN, TREAD or RISER.
    """
    count = len(enough)
    unary = np.stack([np.full(count, UNKNOWN_COST), tread.cost(), riser.cost()], axis=1)  # (K, kind)
    unary[~enough, 1:] = np.inf
    if count == 1:
        return np.argmin(unary, axis=1)
    pair = _pair_costs(tread, riser, line_slope, line_slope_std)  # (K - 1, near kind, far kind)

    from perception.geometry.strips import strip_kernels

    kernels: Any = strip_kernels
    kinds = np.empty(count, dtype=np.int64)
    kernels.cheapest_sequence(unary, pair, kinds)
    return kinds


def _pair_costs(tread: Candidate, riser: Candidate, slope: np.ndarray, slope_std: np.ndarray) -> np.ndarray:
    """(K - 1, 3, 3) cost of each pair of kinds for neighbouring strips, the near one first."""
    cost = np.zeros((len(slope), 3, 3))
    rise, away = np.diff(tread.value), np.diff(riser.value)
    cost[:, TREAD, TREAD] = np.where(np.abs(rise) < SAME_FACE_M, STRIPE_COST, np.where(rise > 0, IMPOSSIBLE_COST, 0.0))
    near, far = np.maximum(riser.value[:-1], 0.1), np.maximum(riser.value[1:], 0.1)
    tread_shows = -slope * near * (1.0 / near - 1.0 / far) > SEEN_TREAD_RAD  # of a tread as high as the nosing
    beyond = np.where(away > 0, np.where(tread_shows, HIDDEN_TREAD_COST, 0.0), IMPOSSIBLE_COST)
    cost[:, RISER, RISER] = np.where(np.abs(away) < SAME_FACE_M, STRIPE_COST, beyond)
    cost[:, TREAD, RISER] = _meeting_cost(tread, slice(None, -1), riser, slice(1, None), slope, slope_std)
    cost[:, RISER, TREAD] = _meeting_cost(tread, slice(1, None), riser, slice(None, -1), slope, slope_std)
    return cost


def _meeting_cost(
    tread: Candidate, treads: slice, riser: Candidate, risers: slice, slope: np.ndarray, slope_std: np.ndarray
) -> np.ndarray:
    """(K - 1,) how far a tread and a riser miss each other along the line where they should meet."""
    forward = riser.value[risers]
    miss = tread.value[treads] - slope * forward
    variance = tread.std[treads] ** 2 + (slope * riser.std[risers]) ** 2 + (slope_std * forward) ** 2
    return np.minimum(0.5 * miss**2 / (variance + MEETING_FLOOR_M**2), MEETING_LIMIT)
