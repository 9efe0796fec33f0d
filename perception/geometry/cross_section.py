"""The cross-section of a staircase: faces and lines put together (figure 5(d) and equation 9 of the paper).

Depth says where each face lies, the lines say at which angle the camera sees each edge. Where a tread and a riser meet
both must agree, so that all faces are adjusted together by least squares: the lines give the shape to a fraction of
a pixel, and all depth readings together give the size.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from perception.geometry.lines import LineSlopes
from perception.geometry.results import Nosing
from perception.geometry.strips.strip_labels import RISER, TREAD, UNKNOWN
from perception.geometry.strips.strip_planes import Faces, LineViews
from stair_env.common.constants import MEASURABLE_RISER_M, MEASURABLE_TREAD_M, TREAD_RANGE_M

DOWN, UP = -1, 1
MIN_TREAD_M = 0.9 * TREAD_RANGE_M[0]  # less is two lines within one tread, and the riser beside them is none either
NARROW_TREAD_M, SURE_RUN = 0.22, 0.04  # a run below, known no better than that part of itself, is half a step as often
MAX_TREAD_STD_M = 0.03  # a run known no better than this tells nothing
MAX_UNEVENNESS = 0.3  # of a riser or tread, relative to the others in view: far more than any old staircase has
UNEVENNESS_STD_M = 0.012  # of the steps of one flight: old stairs; codes allow 9.5 mm between largest and smallest
MAX_HIDDEN_RUN_M = 0.45  # of the tread below a nosing; when more is out of sight, a whole step may be
MAX_SLIVER_PX = 8.0  # an unexplained strip thinner than this lies between two lines of one edge
MAX_MISS_STD = 4.0  # a line that misses the corner of its faces by more is no edge of both
SCALE_STD = 0.003  # a calibrated D435i: within 0.5 %, uniform


@dataclass
class Section:
    """Faces nearest first, after lines within one and the same face are dropped.

    Attributes:
        kind, value: (n,) as in `perception.geometry.strips.strip_planes.Faces`.
        covariance: (n, n) of the values, m^2.
        line, last_line: (n,) index of the lowest and the highest detected line between a face and the next one, which
            differ where a thin strip that nobody can explain was left out; the last entry means nothing.
    """

    kind: np.ndarray
    value: np.ndarray
    covariance: np.ndarray
    line: np.ndarray
    last_line: np.ndarray

    def std_of_difference(self, first: int, second: int) -> float:
        """Standard deviation of the difference of two values, metres."""
        c = self.covariance
        return math.sqrt(max(float(c[first, first] + c[second, second] - 2.0 * c[first, second]), 0.0))

    def std(self, index: int) -> float:
        """Standard deviation of a value, metres."""
        return math.sqrt(max(float(self.covariance[index, index]), 0.0))


def build_section(faces: Faces, views: LineViews, thickness_px: np.ndarray, omega_m: float) -> Section:
    """Merge and adjust.

    Args:
        faces: as fitted to depth.
        views: of the lines between them.
        thickness_px: (K,) of the strips in the image; those beyond the first and last line infinite.
        omega_m: faces of one kind nearer than this are one (the paper's filter of equation 9).
    """
    section = _merge_equal(faces, thickness_px, omega_m)
    return _adjust(section, *views.slopes(faces.camera_to_stair))


def _merge_equal(faces: Faces, thickness_px: np.ndarray, omega_m: float) -> Section:
    """Drop lines that divide one and the same face (painted stripes, tiles), and slivers between two lines that a
    detector drew for one edge."""
    kinds: list[int] = []
    values: list[float] = []
    variances: list[float] = []
    lines: list[int] = []
    last_lines: list[int] = []
    rows = zip(faces.kind.tolist(), faces.value.tolist(), faces.std.tolist(), thickness_px.tolist())
    for index, (kind, value, std, thickness) in enumerate(rows):
        variance = std**2
        if kinds and kind == UNKNOWN and thickness < MAX_SLIVER_PX:
            last_lines[-1] = index
            continue
        if kinds and kind != UNKNOWN and kind == kinds[-1] and abs(value - values[-1]) < omega_m:
            share = variances[-1] / (variances[-1] + variance)
            values[-1] += share * (value - values[-1])
            variances[-1] *= 1.0 - share
            lines[-1] = last_lines[-1] = index
            continue
        kinds.append(kind)
        values.append(value)
        variances.append(variance)
        lines.append(index)  # the line above strip i is line i
        last_lines.append(index)
    return Section(np.array(kinds), np.array(values), np.diag(variances), np.array(lines), np.array(last_lines))


def _adjust(section: Section, slope: np.ndarray, slope_std: np.ndarray) -> Section:
    """Make neighbouring treads and risers meet in the line between them."""
    count = len(section.kind)
    normal = np.diag(1.0 / np.maximum(np.diag(section.covariance), 1e-10))
    right = normal @ section.value
    for near in range(count - 1):
        pair = (section.kind[near], section.kind[near + 1])
        if set(pair) != {TREAD, RISER}:
            continue
        tread, riser = (near, near + 1) if pair[0] == TREAD else (near + 1, near)
        line = _meeting_line(section, near, tread, riser, slope)
        row = np.zeros(count)
        row[tread], row[riser] = 1.0, -slope[line]
        variance = (slope_std[line] * section.value[riser]) ** 2
        if (row @ section.value) ** 2 > MAX_MISS_STD**2 * (variance + row @ section.covariance @ row):
            continue
        normal += np.outer(row, row) / variance
    covariance = np.linalg.inv(normal)
    return Section(section.kind, covariance @ right, covariance, section.line, section.last_line)


def _meeting_line(section: Section, near: int, tread: int, riser: int, slope: np.ndarray) -> int:
    """Of the lines between two faces the one in which they meet best; it becomes the section's line."""
    candidates = range(section.line[near], section.last_line[near] + 1)
    best = min(candidates, key=lambda line: abs(section.value[tread] - slope[line] * section.value[riser]))
    section.line[near] = section.last_line[near] = best
    return best


def find_drops(section: Section) -> tuple[np.ndarray, np.ndarray]:
    """Treads that end where something lower or unexplained begins.

    Returns:
        (n,) indices of the treads, and (n,) heights of the treads one step down that follow them; NaN where what
        follows is unexplained, or so low that a step between the two must have been missed.
    """
    kind, value = section.kind, section.value
    lower = (kind[1:] == TREAD) & (value[1:] < value[:-1])
    treads = np.nonzero((kind[:-1] == TREAD) & (lower | (kind[1:] == UNKNOWN)))[0]
    fall = np.where(lower[treads], value[treads] - value[treads + 1], np.inf)
    usual = float(fall.min(initial=MEASURABLE_RISER_M))
    one_step = fall < (1.0 + MAX_UNEVENNESS) * usual
    return treads, np.where(one_step, value[treads + 1], np.nan)


def walking_direction(section: Section, omega_m: float) -> int:
    """+1 when heights grow away from the camera, -1 when they fall, 0 when neither.

    The paper's rule, both kinds of lines seen means ascending, is the same thing: a riser can only be seen from below.
    """
    votes = int((section.kind == RISER).sum())
    for near, far in itertools.pairwise(section.value[section.kind == TREAD].tolist()):
        if abs(far - near) >= omega_m:
            votes += 1 if far > near else -1
    return (votes > 0) - (votes < 0)


@dataclass(frozen=True)
class _Edge:
    """A nosing in the section.

    Attributes:
        forward, forward_std, height, height_std: metres, relative to the camera.
        before: index of the face that ends at the nosing; the next face begins behind it.
        slope, slope_std: height per forward metre at which its line is seen.
    """

    forward: float
    forward_std: float
    height: float
    height_std: float
    before: int
    slope: float
    slope_std: float


def read_nosings(
    section: Section, direction: int, slopes: LineSlopes, faces: Faces, omega_m: float
) -> tuple[tuple[Nosing, ...], dict[int, str]]:
    """Nosings nearest first, and the kind of every detected line that is an edge.

    Args:
        section: adjusted.
        direction: `walking_direction` of it, not 0.
        slopes: how the camera sees the lines.
        faces: what the section was built from.
        omega_m: smallest riser and tread that counts.
    """
    kinds: dict[int, str] = {}
    edges: list[_Edge] = []
    find = _ascending_edge if direction == UP else _descending_edge
    for index in range(len(section.kind) - 1):
        line = int(section.line[index])
        edge = find(section, index, float(slopes.slope[line]), float(slopes.std[line]), omega_m)
        if edge is not None:
            kinds[line] = "convex"
            edges.append(edge)
        elif section.kind[index] == TREAD and section.kind[index + 1] == RISER:
            kinds[line] = "concave"
    pitch_std = math.sqrt(float(faces.angle_cov[1, 1]))
    finished = [_finish(section, direction, edges, index, slopes, pitch_std, omega_m) for index in range(len(edges))]
    return _steady(_drop_strangers(finished)), kinds


def _drop_strangers(nosings: list[Nosing]) -> tuple[Nosing, ...]:
    """Forget risers and treads that no builder would put beside the others: they come from lines that were missed."""
    kept = nosings
    for name in ("riser", "tread"):
        known = [(getattr(n, f"{name}_m"), getattr(n, f"{name}_std_m")) for n in kept if getattr(n, f"{name}_m")]
        if len(known) < 2:
            continue
        lengths, stds = np.array(known).T
        order = np.argsort(lengths)
        weight = np.cumsum(1.0 / stds[order] ** 2)
        usual = float(lengths[order][np.searchsorted(weight, weight[-1] / 2.0)])
        kept = [
            _without(n, name)
            if getattr(n, f"{name}_m") and abs(getattr(n, f"{name}_m") - usual) > MAX_UNEVENNESS * usual
            else n
            for n in kept
        ]
    return tuple(kept)


def _steady(nosings: tuple[Nosing, ...]) -> tuple[Nosing, ...]:
    """Let steps that are badly seen lean on those that are well seen: lengths of one flight differ by little.

    The mean of a flight's lengths, which differ by UNEVENNESS_STD_M, is a second opinion on each of them.
    """
    steadied = list(nosings)
    for name in ("riser", "tread"):
        known = [index for index, nosing in enumerate(nosings) if getattr(nosing, f"{name}_m") is not None]
        if len(known) < 2:
            continue
        lengths = np.array([getattr(nosings[index], f"{name}_m") for index in known])
        variances = np.array([getattr(nosings[index], f"{name}_std_m") for index in known]) ** 2
        usual_variance = variances + UNEVENNESS_STD_M**2
        usual = float(np.average(lengths, weights=1.0 / usual_variance))
        share = variances / usual_variance
        lengths = lengths + share * (usual - lengths)
        stds = np.sqrt(variances * (1.0 - share) + share**2 / (1.0 / usual_variance).sum())
        for index, length, std in zip(known, lengths.tolist(), stds.tolist()):
            changes: dict[str, Any] = {f"{name}_m": length, f"{name}_std_m": std}
            steadied[index] = replace(steadied[index], **changes)
    return tuple(steadied)


def _without(nosing: Nosing, name: str) -> Nosing:
    unknown: dict[str, Any] = {f"{name}_m": None, f"{name}_std_m": None}
    return replace(nosing, **unknown)


def _ascending_edge(section: Section, index: int, slope: float, slope_std: float, omega_m: float) -> _Edge | None:
    """The nosing at the top of a riser: forward from the riser, height from the tread behind, or from the line."""
    if section.kind[index] != RISER:
        return None
    forward, behind = float(section.value[index]), int(section.kind[index + 1])
    if behind == RISER and section.value[index + 1] < forward + omega_m:
        return None
    by_line = slope * forward
    if behind == TREAD:
        height = float(section.value[index + 1])
        if abs(height - by_line) > omega_m:  # a line on the riser, not at its top
            return None
        return _Edge(forward, section.std(index), height, section.std(index + 1), index, slope, slope_std)
    std = math.hypot(slope_std * forward, slope * section.std(index))
    return _Edge(forward, section.std(index), by_line, std, index, slope, slope_std)


def _descending_edge(section: Section, index: int, slope: float, slope_std: float, omega_m: float) -> _Edge | None:
    """The nosing at the far end of a tread: height from the tread, forward where the line crosses it."""
    if section.kind[index] != TREAD or slope > -0.02:  # at the height of the eye a tread shows no depth
        return None
    height = float(section.value[index])
    if section.kind[index + 1] == TREAD and section.value[index + 1] > height - omega_m:
        return None
    forward = height / slope
    if forward <= 0.0:
        return None
    std = math.hypot(forward * slope_std / slope, section.std(index) / slope)
    return _Edge(forward, std, height, section.std(index), index, slope, slope_std)


def _finish(
    section: Section,
    direction: int,
    edges: list[_Edge],
    index: int,
    slopes: LineSlopes,
    pitch_std: float,
    omega_m: float,
) -> Nosing:
    """Add riser and tread, where the faces that bound them are known and adjoin."""
    near, edge, far = edges[index - 1] if index else None, edges[index], (*edges, None)[index + 1]
    ascending = direction == UP
    riser = _riser(section, direction, edge, near, slopes)
    if riser is not None and not omega_m <= riser[0] <= MEASURABLE_RISER_M:
        riser = None
    tread = _tread(section, direction, edge, far)
    if tread and (tread[0] < MIN_TREAD_M or (tread[0] < NARROW_TREAD_M and tread[1] > SURE_RUN * tread[0])):
        riser = tread = None
    if tread is not None and (tread[0] > MEASURABLE_TREAD_M or tread[1] > MAX_TREAD_STD_M or not (riser or ascending)):
        tread = None
    return Nosing(
        distance_m=edge.forward,
        distance_std_m=math.hypot(edge.forward_std, SCALE_STD * edge.forward),
        height_m=edge.height,
        height_std_m=math.hypot(edge.height_std, pitch_std * edge.forward),
        riser_m=riser[0] if riser else None,
        riser_std_m=_with_common_errors(riser, pitch_std * (tread[0] if tread else 0.3)) if riser else None,
        tread_m=tread[0] if tread else None,
        tread_std_m=_with_common_errors(tread, pitch_std * (riser[0] if riser else 0.15)) if tread else None,
    )


def _with_common_errors(measured: tuple[float, float], pitch_error_m: float) -> float:
    """Standard deviation of a length with what pitch and depth scale add."""
    length, std = measured
    return math.sqrt(std**2 + pitch_error_m**2 + (SCALE_STD * length) ** 2)


def _riser(
    section: Section, direction: int, edge: _Edge, near: _Edge | None, slopes: LineSlopes
) -> tuple[float, float] | None:
    """Height and standard deviation of the riser at a nosing: below it going up, beyond it going down."""
    face = edge.before + 1 if direction == DOWN else edge.before - 1
    level = edge.before if direction == DOWN else edge.before + 1
    if _is(section, face, TREAD):
        lower = float(section.value[face])
        if direction == DOWN and _may_hide_a_step(edge, lower):
            return None
        std = (
            section.std_of_difference(level, face)
            if _is(section, level, TREAD)
            else math.hypot(edge.height_std, section.std(face))
        )
        return abs(edge.height - lower), std
    if direction == UP and near is not None and near.before in (face, face - _is(section, face, UNKNOWN)):
        # The tread hides behind the nosing below, or depth shows nothing of it.
        return edge.height - near.height, math.hypot(edge.height_std, near.height_std)
    if direction == UP and _is(section, face, UNKNOWN):
        return _by_foot(section, edge, slopes)
    return None


def _by_foot(section: Section, edge: _Edge, slopes: LineSlopes) -> tuple[float, float] | None:
    """A riser from the line at its foot, where depth shows nothing of the tread before it."""
    foot, top = section.last_line[edge.before - 1], section.line[edge.before]
    slope, slope_std = float(slopes.slope[foot]), float(slopes.std[foot])
    std = math.hypot(edge.forward * slope_std, slope * edge.forward_std, edge.height_std)
    return (edge.height - slope * edge.forward, std) if slopes.confirmed[foot] and slopes.confirmed[top] else None


def _tread(section: Section, direction: int, edge: _Edge, far: _Edge | None) -> tuple[float, float] | None:
    """Run and its standard deviation, from a nosing to the next riser (up) or the next nosing (down)."""
    if direction == UP:
        risers = [face for face in (edge.before + 1, edge.before + 2) if _is(section, face, RISER)]
        if not risers:
            return None
        run = float(section.value[risers[0]] - section.value[edge.before])
        return run, section.std_of_difference(edge.before, risers[0])
    if far is None or far.before != edge.before + 1:
        return None
    return far.forward - edge.forward, _run_std(section, edge, far)


def _run_std(section: Section, edge: _Edge, far: _Edge) -> float:
    """Standard deviation of the run between two descending nosings, metres: what both heights share cancels."""
    c, near_face, far_face = section.covariance, edge.before, far.before
    by_near, by_far = 1.0 / edge.slope, 1.0 / far.slope
    heights = by_near**2 * c[near_face, near_face] + by_far**2 * c[far_face, far_face]
    heights -= 2.0 * by_near * by_far * c[near_face, far_face]
    lines = math.hypot(edge.forward * edge.slope_std / edge.slope, far.forward * far.slope_std / far.slope)
    return math.hypot(math.sqrt(max(float(heights), 0.0)), lines)


def _is(section: Section, face: int, kind: int) -> bool:
    return 0 <= face < len(section.kind) and bool(section.kind[face] == kind)


def _may_hide_a_step(edge: _Edge, lower_m: float) -> bool:
    """Whether the line of sight over a descending nosing meets the next tread in view too far behind it.

    A step is out of sight when the view over the nosing is flatter than the stairs; what is seen next then lies more
    than two treads behind.
    """
    view = max(-edge.height, 1e-3) / max(edge.forward, 1e-3)
    return (edge.height - lower_m) / view > MAX_HIDDEN_RUN_M
