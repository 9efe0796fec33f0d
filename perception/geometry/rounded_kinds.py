"""What `rounded` fits: the rows of a cross-section, the lines in it, and which faces lie between them.

From one line to the next the inverse distance changes as the cosine of the angle on a riser, and as its sine on a
tread. Rounded creases hardly change that, so that it tells treads from risers where their faces do not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from perception.geometry.lines import median
from perception.geometry.profile.depth_profile import COLUMNS, Scan
from perception.geometry.strips.strip_labels import RISER, TREAD, UNKNOWN

FAR_ROWS = 53  # of the strips before the first and behind the last line, for what they show: 0.22 of the height
MIN_TREAD_RAD = 0.013  # going down; 8 px at f = 615 px: a jitter of a pixel is an eighth of the step
RATIO_STD = 0.012  # of an inverse distance at a line, relative: a quarter of a pixel at 1 m
RATIO_ROUNDING = 0.15  # share of a face that rounding its creases may hide
MAX_KIND_COST = 9.0
STRIPE_COST, HIDDEN_TREAD_COST = 1.0, 3.0
OUTER_KIND_COST = 3.0  # of an outer strip that is left unexplained
OUTER_STD = 0.015  # relative deviation from a face within an outer strip
BELOW_EYE_RAD = -0.015  # a tread seen flatter than this shows no depth


@dataclass(frozen=True)
class Rows:
    """The cross-section as angles and inverse depths, nearest row first.

    Attributes:
        angle: (J,) above the horizontal, radians.
        inverse_depth: (J,) 1 / m, 0 where there is nothing.
        per_depth: (J,) distance in the section per depth.
        weight: (J,) share of the columns that were read.
    """

    angle: np.ndarray
    inverse_depth: np.ndarray
    per_depth: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, scan: Scan) -> Rows:
        """Those of a cross-section as it is seen."""
        seen = (scan.readings > 0) & (scan.depth_m > 0.0)
        count = len(scan.slope)
        inverse = np.where(seen, 1.0 / np.maximum(scan.depth_m, 1e-3), 0.0)
        ratio = np.hypot(scan.forward_m, scan.height_m) * inverse
        per_depth = np.interp(np.arange(count), np.nonzero(seen)[0], ratio[seen]) if seen.any() else np.ones(count)
        weight = np.minimum(scan.readings / COLUMNS, 1.0)
        return cls(np.arctan(scan.slope), inverse, per_depth, weight)


@dataclass(frozen=True)
class RowLines:
    """Lines in the section: row, angle and its standard deviation, which of the given ones, and the row at which what
    lies behind the last of them ends."""

    row: np.ndarray
    angle: np.ndarray
    std: np.ndarray
    source: np.ndarray
    end: float = np.inf

    def chosen(self, which: Any) -> RowLines:
        """Some of them, by index or mask."""
        return RowLines(self.row[which], self.angle[which], self.std[which], self.source[which], self.end)


def lines_in_section(scan: Scan, slope: np.ndarray, slope_std: np.ndarray) -> RowLines:
    """The lines within the scanned rows, each farther than the one before."""
    kept: list[int] = []
    for index in range(len(slope)):
        inside = len(scan.slope) > 1 and scan.slope[0] < slope[index] < scan.slope[-1]
        if inside and (not kept or slope[index] > slope[kept[-1]] + 1e-3):
            kept.append(index)
    source = np.array(kept, dtype=int)
    row = np.interp(slope[source], scan.slope, np.arange(len(scan.slope))) if len(source) else np.empty(0)
    return RowLines(row, np.arctan(slope[source]), slope_std[source] / (1.0 + slope[source] ** 2), source)


def clear_lines(lines: RowLines) -> RowLines:
    """The lines up to where they lie too close together for the treads between them to be seen from above."""
    close = np.nonzero(np.diff(lines.angle) < MIN_TREAD_RAD)[0]
    count = int(close[0]) + 1 if len(close) else len(lines.row)
    if count == len(lines.row):
        return lines
    return replace(lines.chosen(slice(count)), end=float(lines.row[count]))


def round_kinds(rows: Rows, lines: RowLines, turn: float, direction: int) -> np.ndarray | None:
    """(K,) which faces lie between the lines, as the distances at the lines have it; None where that is absurd."""
    count = len(lines.row) + 1
    near, far = _outer_costs(rows, lines, turn, 0), _outer_costs(rows, lines, turn, -1)
    if direction < 0:
        kind = np.full(count, TREAD)
        if lines.angle[0] + turn > BELOW_EYE_RAD:
            return None
        steep = np.append(lines.angle, lines.angle[-1]) + turn > BELOW_EYE_RAD
        kind[steep] = UNKNOWN
        if far[0] < far[1]:
            kind[-1] = UNKNOWN
        return kind
    unary = np.empty((count, 3))
    unary[0], unary[-1] = near, far
    unary[1:-1] = _strip_costs(rows, lines, turn)
    pair = np.zeros((count - 1, 3, 3))
    pair[:, TREAD, TREAD] = STRIPE_COST
    tread_seen = lines.angle + turn < BELOW_EYE_RAD
    pair[:, RISER, RISER] = np.where(tread_seen, HIDDEN_TREAD_COST, 0.0)
    from perception.geometry.strips import strip_kernels

    kernels: Any = strip_kernels
    kinds = np.empty(count, dtype=np.int64)
    kernels.cheapest_sequence(unary, pair, kinds)
    return kinds if (kinds == RISER).any() else None


def _strip_costs(rows: Rows, lines: RowLines, turn: float) -> np.ndarray:
    """(K - 2, 3) cost of the kinds of the strips between two lines.

    From one line to the next the inverse distance changes as the cosine of the angle on a riser and as its sine on a
    tread: where the change lies between the two says which it is, however round the creases are.
    """
    inverse = np.array([_at_row(rows, row) for row in lines.row])
    angle = lines.angle + turn
    sin, cos = np.sin(angle), np.maximum(np.cos(angle), 1e-3)
    both = (inverse[:-1] > 0.0) & (inverse[1:] > 0.0)
    change = np.log(np.maximum(inverse[1:], 1e-6) / np.maximum(inverse[:-1], 1e-6))
    as_riser = np.log(cos[1:] / cos[:-1])
    below = (sin[1:] < math.sin(BELOW_EYE_RAD)) & (sin[:-1] < math.sin(BELOW_EYE_RAD))
    as_tread = np.log(np.where(below, sin[1:], -1.0) / np.where(below, sin[:-1], -1.0))
    apart = np.maximum(np.abs(as_tread - as_riser), 1e-3)
    std = np.hypot(RATIO_STD * math.sqrt(2.0), RATIO_ROUNDING * apart)
    cost = np.empty((len(change), 3))
    cost[:, UNKNOWN] = MAX_KIND_COST
    cost[:, RISER] = np.where(both, np.minimum(0.5 * ((change - as_riser) / std) ** 2, MAX_KIND_COST), 1.0)
    cost[:, TREAD] = np.where(both, np.minimum(0.5 * ((change - as_tread) / std) ** 2, MAX_KIND_COST), 1.0)
    cost[~below, TREAD] = np.inf
    cost[~below, RISER] = 0.0
    return cost


def _at_row(rows: Rows, row: float, reach: int = 3) -> float:
    """Inverse distance in the section around a row, 1 / m; 0 where nothing is seen."""
    for wider in (reach, 3 * reach):
        low, high = max(int(row) - wider, 0), int(row) + wider + 2
        near = rows.inverse_depth[low:high] / rows.per_depth[low:high]
        near = near[near > 0.0]
        if len(near) >= 2:
            return median(near)
    return 0.0


def _outer_costs(rows: Rows, lines: RowLines, turn: float, end: int) -> np.ndarray:
    """(3,) cost of the kinds of the strip before the first (end 0) or behind the last line (end -1)."""
    row = round(float(lines.row[end]))
    low, high = (max(row - FAR_ROWS, 0), row - 3) if end == 0 else (row + 4, min(row + FAR_ROWS, lines.end))
    part = slice(low, int(max(high, low)))
    angle, inverse = rows.angle[part] + turn, rows.inverse_depth[part] / rows.per_depth[part]
    seen = inverse > 0.0
    cost = np.array([OUTER_KIND_COST, np.inf, np.inf])
    if seen.sum() < 6:
        return np.array([0.0, 1.0, 1.0])
    angle, inverse = angle[seen], inverse[seen]
    for kind, shape in ((TREAD, np.sin(angle)), (RISER, np.cos(angle))):
        if kind == TREAD and (shape > math.sin(BELOW_EYE_RAD)).mean() > 0.5:
            continue
        value = median(inverse / shape)
        if kind == TREAD and value > 0.0:
            continue
        miss = np.minimum(np.abs(inverse / (value * shape) - 1.0) / OUTER_STD, 3.0)
        cost[kind] = float(np.mean(miss**2))
    return cost
