"""The cross-section where depth is too smooth, or gravity too wrong, for faces to be read one by one.

A stereo matcher rounds every crease over its window, so that between two lines there may be no straight face left, and
a flight is nearly a ramp. What remains true is the sum: *inverse* depth, which is what the matcher measures, is that of
the staircase blurred along the rows. The lines say at which angle every edge is seen; with them, a tread (seen under
the angle a at the inverse distance sin(a) / H) and a riser (cos(a) / F) leave one number to each face. These numbers,
the pitch that gravity left wrong, and the width of the blur are fitted to all rows at once. Rows without depth just do
not count: a face that nobody sees still lies between two lines.

The width of the blur is the frame's *crease width*: readings nearer to a line than that belong to both faces.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from perception.geometry.profile.depth_profile import COLUMNS, ROWS, Scan
from perception.geometry.strips.strip_labels import RISER, SAME_FACE_M, TREAD, UNKNOWN

NEAR_ROWS, FAR_ROWS = 120, 53  # of the strips before the first and behind the last line that are read
CREASE_ROWS = (0.8, 2.0, 3.5, 5.5, 8.0, 11.0)  # standard deviations of the blur that are tried
FATTENING_ROWS = (1.5, 3.0, 4.5)  # by which what is in front hides what is behind a descending nosing
NOISE = 0.006  # 1/m, of a row's inverse depth: 0.13 px at 447 px and 50 mm, what sub-pixel locking of a matcher leaves
LEAST_NOISE = 0.002  # 1/m: the D435i's 0.08 px over the readings of a row
ROWS_PER_READING = 30.0  # a matcher's waves are that long; measured: the pitch errs less than with 7, 14 or 60
CUT = 3.0  # standard deviations from which a row has no weight
USUAL_RISER_M, USUAL_TREAD_M, USUAL_STD_M = 0.16, 0.29, 0.08  # any stairs: hardly a prior
RISERS_M, TREADS_M = (0.05, 0.26), (0.18, 0.50)  # nothing else is a staircase
UNEVENNESS_STD_M = 0.012  # as in `perception.geometry.cross_section`
TURN_TRIES_RAD = tuple(math.radians(degrees) for degrees in (0.0, -5.0, 5.0, -10.0, 10.0))
SATISFYING = 0.85  # share of the rows explained beyond which no other pitch is tried
GUESS_ROWS = 2.0  # blur of the first explanation
FREE_TURN_STD_RAD = math.radians(20.0)
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
        """Those of a scanned scan."""
        seen = (scan.readings > 0) & (scan.depth_m > 0.0)
        count = len(scan.slope)
        inverse = np.where(seen, 1.0 / np.maximum(scan.depth_m, 1e-3), 0.0)
        ratio = np.hypot(scan.forward_m, scan.height_m) * inverse
        per_depth = np.interp(np.arange(count), np.nonzero(seen)[0], ratio[seen]) if seen.any() else np.ones(count)
        weight = np.minimum(scan.readings / COLUMNS, 1.0)
        return cls(np.arctan(scan.slope), inverse, per_depth, weight)


@dataclass(frozen=True)
class RoundedFit:
    """Faces between the lines, nearest first.

    Attributes:
        kind, value: (K,) as in `perception.geometry.strips.strip_planes.Faces`.
        covariance: (K, K) of the values, m^2, with what the pitch adds.
        line: (K - 1,) which of the given lines lies between a face and the next.
        direction: +1 ascending, -1 descending, 0 neither.
        turn_rad, turn_std_rad: how much steeper everything is seen than gravity says (pitch of the camera, head up
            positive, that gravity lacks), and its standard deviation.
        crease_px: standard deviation of the blur, pixels of the image.
        noise: standard deviation of a row about the fit, 1 / m.
        explained: share of the rows between the lines that the fit explains.
        cost: squared standard deviations, to compare fits of one frame.
    """

    kind: np.ndarray
    value: np.ndarray
    covariance: np.ndarray
    line: np.ndarray
    direction: int
    turn_rad: float
    turn_std_rad: float
    crease_px: float
    noise: float
    explained: float
    cost: float


@dataclass(frozen=True)
class _Lines:
    """Lines in the section: row, angle and its standard deviation, and which of the given ones."""

    row: np.ndarray
    angle: np.ndarray
    std: np.ndarray
    source: np.ndarray


def fit_rounded(
    scan: Scan, line_slope: np.ndarray, line_slope_std: np.ndarray, turn_std_rad: float, image_height: int
) -> RoundedFit | None:
    """Explain the cross-section by a blurred staircase whose edges are seen where the lines are.

    Args:
        scan: the cross-section as it is seen.
        line_slope, line_slope_std: (m,) height per forward metre at which each line is seen, nearest first.
        turn_std_rad: how far gravity is trusted.
        image_height: pixels.

    Returns:
        The best explanation, going up or down; None without enough lines or depth.
    """
    rows = Rows.of(scan)
    lines = _in_section(scan, line_slope, line_slope_std)
    if len(lines.row) < 2 or (rows.inverse_depth > 0.0).sum() < 20:
        return None
    ways = {1: lines, -1: _clear(lines)}
    best: _Guess | None = None
    for turn in TURN_TRIES_RAD:
        if best is not None and best.explained > SATISFYING:
            break
        for direction in (1, -1):
            best = _better(best, _guess(rows, ways[direction], direction, turn, turn_std_rad))
    if best is None:
        return None
    lines = ways[best.direction]
    # Gravity holds the pitch fast where it is wrong by little more than it may be: ask depth alone, and compare.
    alone = _solve(rows, lines, best.kind, best.direction, GUESS_ROWS, best.turn, FREE_TURN_STD_RAD)[0][0]
    if abs(alone - best.turn) > turn_std_rad:
        best = _better(best, _guess(rows, lines, best.direction, float(alone), turn_std_rad)) or best
    kind, direction = best.kind, best.direction
    solve = functools.partial(_solve, rows, lines, kind, direction, turn=best.turn, turn_std_rad=turn_std_rad)
    fits = [(*solve(width=width), width) for width in CREASE_ROWS]
    found = min(fits, key=_cost)
    if direction < 0:
        found = min(
            [found, *((*solve(width=found[3], fattening=more), found[3]) for more in FATTENING_ROWS)], key=_cost
        )
    answer, inverse, covariance, width = found
    if width == CREASE_ROWS[-1]:  # so round that nothing is left of the steps: a ramp with stripes looks the same
        return None
    usual = float(answer[4]), float(answer[5])
    if not (np.isfinite(covariance).all() and np.isfinite(inverse).all() and _is_stairs(kind, *usual)):
        return None
    return _as_fit(answer, inverse, covariance, kind, lines, direction, width * image_height / ROWS)


def _cost(found: tuple[np.ndarray, np.ndarray, np.ndarray, float]) -> float:
    return float(found[0][1])


@dataclass(frozen=True)
class _Guess:
    """Faces of one explanation, the pitch that goes with them, and how well they explain the rows."""

    kind: np.ndarray
    direction: int
    turn: float
    explained: float
    cost: float


def _guess(rows: Rows, lines: _Lines, direction: int, turn: float, turn_std_rad: float) -> _Guess | None:
    """The staircase that leads in a direction, if gravity is off by a turn; None where that is absurd."""
    kind = _kinds(rows, lines, turn, direction) if len(lines.row) > 1 else None
    if kind is None:
        return None
    answer, inverse, _ = _solve(rows, lines, kind, direction, GUESS_ROWS, turn, turn_std_rad)
    if not _runs(kind, inverse, direction):
        return None
    return _Guess(kind, direction, float(answer[0]), float(answer[3]), float(answer[1]))


def _better(one: _Guess | None, other: _Guess | None) -> _Guess | None:
    return other if one is None or (other is not None and other.cost < one.cost) else one


def _is_stairs(kind: np.ndarray, riser_m: float, tread_m: float) -> bool:
    """Whether the flight's usual step is one that people climb, as far as it was seen."""
    several = (kind == TREAD).sum() > 1
    return not several or (RISERS_M[0] < riser_m < RISERS_M[1] and TREADS_M[0] < tread_m < TREADS_M[1])


def _runs(kind: np.ndarray, inverse: np.ndarray, direction: int) -> bool:
    """Whether the treads rise or fall as they should, and the risers go away from the camera."""
    treads, risers = inverse[kind == TREAD], inverse[kind == RISER]
    falls = (treads < 0.0).all() and (np.diff(1.0 / treads) * direction > -SAME_FACE_M).all()
    return bool(falls and (risers > 0.0).all() and (np.diff(1.0 / risers) > -SAME_FACE_M).all())


def _as_fit(
    answer: np.ndarray,
    inverse: np.ndarray,
    covariance: np.ndarray,
    kind: np.ndarray,
    lines: _Lines,
    direction: int,
    crease_px: float,
) -> RoundedFit:
    count = len(kind)
    known = (kind != UNKNOWN) & (np.abs(inverse) > 1e-3)
    value = np.where(known, 1.0 / np.where(known, inverse, 1.0), 0.0)
    by_value = -(value**2)  # dH / d(1 / H)
    cov = covariance[:count, :count] * np.outer(by_value, by_value)
    return RoundedFit(
        kind=np.where(known, kind, UNKNOWN),
        value=value,
        covariance=cov,
        line=lines.source,
        direction=direction,
        turn_rad=float(answer[0]),
        turn_std_rad=math.sqrt(max(float(covariance[count, count]), 0.0)),
        crease_px=crease_px,
        noise=float(answer[2]),
        explained=float(answer[3]),
        cost=float(answer[1]),
    )


def _in_section(scan: Scan, slope: np.ndarray, slope_std: np.ndarray) -> _Lines:
    """The lines within the scanned rows, each farther than the one before."""
    kept: list[int] = []
    for index in range(len(slope)):
        inside = len(scan.slope) > 1 and scan.slope[0] < slope[index] < scan.slope[-1]
        if inside and (not kept or slope[index] > slope[kept[-1]] + 1e-3):
            kept.append(index)
    source = np.array(kept, dtype=int)
    row = np.interp(slope[source], scan.slope, np.arange(len(scan.slope))) if len(source) else np.empty(0)
    return _Lines(row, np.arctan(slope[source]), slope_std[source] / (1.0 + slope[source] ** 2), source)


def _clear(lines: _Lines) -> _Lines:
    """The lines up to where they lie too close together for the treads between them to be seen from above."""
    close = np.nonzero(np.diff(lines.angle) < MIN_TREAD_RAD)[0]
    count = int(close[0]) + 1 if len(close) else len(lines.row)
    return _Lines(lines.row[:count], lines.angle[:count], lines.std[:count], lines.source[:count])


def _solve(
    rows: Rows,
    lines: _Lines,
    kind: np.ndarray,
    direction: int,
    width: float,
    turn: float,
    turn_std_rad: float,
    fattening: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Answer (6,), inverse values (K,) and covariance (K + 3, K + 3) of `rounded_kernels.fit`."""
    from perception.geometry import rounded_kernels

    kernels: Any = rounded_kernels
    count, faces = len(rows.angle), len(kind)
    share, moment = np.empty((count, faces)), np.empty((count, faces))
    kernels.blur_weights(lines.row + fattening, width, count, share, moment)
    place = np.arange(count)
    row_weight = np.where((place > lines.row[0] - NEAR_ROWS) & (place < lines.row[-1] + FAR_ROWS), rows.weight, 0.0)
    inverse, covariance = np.zeros(faces), np.empty((faces + 3, faces + 3))
    answer = np.array([0.0, turn, 0.0, 0.0, 0.0, 0.0])
    kernels.fit(
        rows.inverse_depth,
        row_weight,
        rows.angle,
        rows.per_depth,
        share,
        moment,
        lines.angle,
        lines.std,
        kind,
        (NOISE, ROWS_PER_READING, CUT, LEAST_NOISE),
        turn_std_rad,
        (UNEVENNESS_STD_M, USUAL_RISER_M, USUAL_TREAD_M, USUAL_STD_M, float(direction)),
        inverse,
        covariance,
        answer,
    )
    return answer, inverse, covariance


def _kinds(rows: Rows, lines: _Lines, turn: float, direction: int) -> np.ndarray | None:
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


def _strip_costs(rows: Rows, lines: _Lines, turn: float) -> np.ndarray:
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
            return float(np.median(near))
    return 0.0


def _outer_costs(rows: Rows, lines: _Lines, turn: float, end: int) -> np.ndarray:
    """(3,) cost of the kinds of the strip before the first (end 0) or behind the last line (end -1)."""
    row = round(float(lines.row[end]))
    low, high = (max(row - FAR_ROWS, 0), row - 3) if end == 0 else (row + 4, row + FAR_ROWS)
    part = slice(low, max(high, low))
    angle, inverse = rows.angle[part] + turn, rows.inverse_depth[part] / rows.per_depth[part]
    seen = inverse > 0.0
    cost = np.array([OUTER_KIND_COST, np.inf, np.inf])
    if seen.sum() < 6:
        return np.array([0.0, 1.0, 1.0])
    angle, inverse = angle[seen], inverse[seen]
    for kind, shape in ((TREAD, np.sin(angle)), (RISER, np.cos(angle))):
        if kind == TREAD and (shape > math.sin(BELOW_EYE_RAD)).mean() > 0.5:
            continue
        value = np.median(inverse / shape)
        if kind == TREAD and value > 0.0:
            continue
        miss = np.minimum(np.abs(inverse / (value * shape) - 1.0) / OUTER_STD, 3.0)
        cost[kind] = float(np.mean(miss**2))
    return cost
