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

from perception.geometry.profile.depth_profile import ROWS, Scan
from perception.geometry.rounded_kinds import FAR_ROWS, RowLines, Rows, clear_lines, lines_in_section, round_kinds
from perception.geometry.strips.strip_labels import RISER, SAME_FACE_M, TREAD, UNKNOWN

NEAR_ROWS = 120  # of the strip before the first line that are read: a floor tells the pitch
CREASE_ROWS = (0.8, 2.0, 3.5, 5.5, 8.0, 11.0)  # standard deviations of the blur that are tried
FATTENING_ROWS = (1.5, 3.0, 4.5)  # by which what is in front hides what is behind a descending nosing
NOISE = 0.006  # 1/m, of a row's inverse depth: 0.13 px at 447 px and 50 mm, what sub-pixel locking of a matcher leaves
LEAST_NOISE = 0.002  # 1/m: the D435i's 0.08 px over the readings of a row
ROWS_PER_READING = 30.0  # a matcher's waves: with 14 the steps err by half as much again, with 60 a tenth fewer pass
CUT = 3.0  # standard deviations from which a row has no weight
USUAL_RISER_M, USUAL_TREAD_M, USUAL_STD_M = 0.16, 0.29, 0.08  # any stairs: hardly a prior
RISERS_M, TREADS_M = (0.05, 0.26), (0.18, 0.50)  # nothing else is a staircase
UNEVENNESS_STD_M = 0.012  # as in `perception.geometry.cross_section`
TURN_TRIES_RAD = tuple(math.radians(degrees) for degrees in (0.0, -5.0, 5.0, -10.0, 10.0))
SATISFYING = 0.85  # share of the rows explained beyond which no other pitch is tried
GUESS_ROWS = 2.0  # blur of the first explanation
GUESS_TURN_RAD = math.radians(0.5)
MAX_DOUBT = 2.5  # standard deviations that depth may want the pitch turned by; with the right gravity 2 in 1 of 40
FREE_TURN_STD_RAD = math.radians(20.0)


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
    lines = lines_in_section(scan, line_slope, line_slope_std)
    if len(lines.row) < 2 or (rows.inverse_depth > 0.0).sum() < 20:
        return None
    ways = {1: lines, -1: clear_lines(lines)}
    best: _Guess | None = None
    for turn in TURN_TRIES_RAD:
        if best is not None and best.explained > SATISFYING:
            break
        for direction in (1, -1):
            best = _better(best, _guess(rows, ways[direction], direction, turn, turn_std_rad))
    if best is None:
        return None
    # Gravity holds the pitch fast, right or wrong: ask depth alone, too.
    answer, _, covariance = _solve(
        rows, best.lines, best.kind, best.direction, GUESS_ROWS, best.turn, FREE_TURN_STD_RAD
    )
    alone, doubt = float(answer[0]), math.sqrt(max(float(covariance[len(best.kind), len(best.kind)]), 0.0))
    if abs(alone) > MAX_DOUBT * doubt:
        turn_std_rad = FREE_TURN_STD_RAD
    if abs(alone - best.turn) > GUESS_TURN_RAD:
        other = _guess(rows, ways[best.direction], best.direction, alone, turn_std_rad)
        best = other if other is not None and turn_std_rad == FREE_TURN_STD_RAD else _better(best, other) or best
    lines, kind, direction = best.lines, best.kind, best.direction
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
    """Faces and lines of one explanation, the pitch that goes with them, and how well they explain the rows."""

    lines: RowLines
    kind: np.ndarray
    direction: int
    turn: float
    explained: float
    cost: float


def _guess(rows: Rows, lines: RowLines, direction: int, turn: float, turn_std_rad: float) -> _Guess | None:
    """The staircase that leads in a direction, if gravity is off by a turn; None where that is absurd."""
    kind = round_kinds(rows, lines, turn, direction) if len(lines.row) > 1 else None
    if kind is None:
        return None
    if direction > 0:  # a line between treads of one height is a stripe
        apart = (kind[:-1] != TREAD) | (kind[1:] != TREAD)
        lines, kind = lines.chosen(apart), kind[np.append(True, apart)]
    answer, inverse, _ = _solve(rows, lines, kind, direction, GUESS_ROWS, turn, turn_std_rad)
    if not _runs(kind, inverse, direction):
        return None
    return _Guess(lines, kind, direction, float(answer[0]), float(answer[3]), float(answer[1]))


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
    lines: RowLines,
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


def _solve(
    rows: Rows,
    lines: RowLines,
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
    row_weight = np.where(
        (place > lines.row[0] - NEAR_ROWS) & (place < min(lines.row[-1] + FAR_ROWS, lines.end)), rows.weight, 0.0
    )
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
