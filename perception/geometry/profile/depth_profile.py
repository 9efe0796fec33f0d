"""The cross-section of a staircase from depth alone, and what it says about the detector's lines.

Every line of a straight flight runs along the same lateral axis, so that everything the camera sees under one slope
(height per forward metre) is equally far and equally high. The picture therefore collapses to one curve, forward
distance over slope, in which each row is the median of hundreds of pixels. That curve is cut into treads (height
constant), risers (distance constant) and what is neither. The cuts are stair edges. They find the lines that the
detector missed, and lines that the detector drew in the middle of a face, on a tile's joint or a shadow, are known by
the lack of one.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from perception.geometry.lines import median
from perception.geometry.strips.strip_labels import RISER, TREAD, UNKNOWN
from perception.geometry.strips.strip_planes import DEPTH_SIGMA_PER_M2, MAX_DEPTH_M, MIN_DEPTH_M
from stair_env.intrinsics import Intrinsics

ROWS = 240  # of the cross-section: one for two of the image's at 640 x 480
COLUMNS = 40  # readings per row
MIN_READINGS = 6
COLUMNS_PER_READING = 2.0  # at this spacing neighbours of a row share part of their noise
ROWS_PER_READING = 4.0  # neighbouring rows, 2 px apart at 640 x 480, share most of it
PLACE_STD_M = 0.006  # floor: gravity off by 0.7 degrees tilts a face of 0.3 m by this much
FACE_COST = 8.0  # of one more face, squared standard deviations: noise does not pay for a face
UNKNOWN_COST = 3.0  # per row that no face explains
MIN_FACE_ROWS = 3
MIN_HIDDEN_ROWS = 2  # unexplained rows between two risers that may be the tread between them
MAX_GAP_ROWS = 8  # unexplained rows between two faces that still meet there: smeared and missing depth
CUT_TURNS_RAD = tuple(math.radians(degrees) for degrees in range(-12, 13))  # that `pitch_from_cut` tries
CUT_TURN_STD_RAD = math.radians(0.5)
CORNER_MISS_ROWS = 6.0  # of the corner of two planes from the cut between them; beyond that they do not meet


@dataclass(frozen=True)
class ProfileEdge:
    """Where two faces meet, or one ends before another.

    Attributes:
        forward_m, height_m: relative to the camera.
        near_kind, far_kind: TREAD or RISER; UNKNOWN where depth says nothing on that side. Such an end of a riser is an
            edge only if a detector sees one there: depth ends for other reasons, too.
    """

    forward_m: float
    height_m: float
    near_kind: int
    far_kind: int


@dataclass(frozen=True)
class Scan:
    """The cross-section as it is seen, nearest row first.

    Attributes:
        slope: (J,) height per forward metre of each row.
        forward_m, height_m: (J,) what is seen there; 0 where nothing is.
        depth_m: (J,) depth that goes with it.
        readings: (J,) how many readings a row rests on.
    """

    slope: np.ndarray
    forward_m: np.ndarray
    height_m: np.ndarray
    depth_m: np.ndarray
    readings: np.ndarray


@dataclass(frozen=True)
class Profile(Scan):
    """The cross-section, cut into faces.

    Attributes:
        face: (J,) index of the face of each row, -1 for none.
        kind, value: (K,) TREAD or RISER of each face; its height or forward distance, metres.
        edges: nearest first.
    """

    face: np.ndarray
    kind: np.ndarray
    value: np.ndarray
    edges: tuple[ProfileEdge, ...]


def read_profile(
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
    camera_to_stair: np.ndarray,
    middle_x: float,
    lateral_m: tuple[float, float],
    omega_m: float,
) -> Profile:
    """Scan and cut the cross-section.

    Args:
        depth_m: (H, W) float, metres, 0 = no reading.
        intrinsics: of the depth image.
        camera_to_stair: (3, 3) rotation into (f, l, h).
        middle_x: image column in which the rows of the cross-section are evenly spaced, pixels.
        lateral_m: least and greatest l of the staircase, metres.
        omega_m: faces of one kind nearer than this are one.
    """
    scan = scan_profile(depth_m, intrinsics, camera_to_stair, middle_x, lateral_m)
    first, kind, _ = _segment(scan)
    face, kinds, values, spans = _faces(first, kind, scan, omega_m)
    edges = _edges(kinds, values, spans, scan.slope)
    return Profile(
        scan.slope,
        scan.forward_m,
        scan.height_m,
        scan.depth_m,
        scan.readings,
        face,
        np.array(kinds, dtype=int),
        np.array(values),
        edges,
    )


def scan_profile(
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
    camera_to_stair: np.ndarray,
    middle_x: float,
    lateral_m: tuple[float, float],
) -> Scan:
    """The cross-section as it is seen; arguments as in `read_profile`."""
    slope = _row_slopes(intrinsics, camera_to_stair, middle_x)
    return _scan(depth_m, intrinsics, camera_to_stair, slope, lateral_m)


def _row_slopes(intrinsics: Intrinsics, rotation: np.ndarray, middle_x: float) -> np.ndarray:
    """(J,) slopes under which one image column sees its rows, bottom to top; only rows that look forward."""
    v = intrinsics.height * (1.0 - (np.arange(ROWS) + 0.5) / ROWS)
    x, y = (middle_x - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy
    rays = np.stack([np.full_like(y, x), y, np.ones_like(y)], axis=1) @ rotation.T
    ahead = rays[:, 0] > 0.05
    return np.ascontiguousarray(rays[ahead, 2] / rays[ahead, 0])


def _scan(
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
    rotation: np.ndarray,
    slope: np.ndarray,
    lateral_m: tuple[float, float],
) -> Scan:
    """One reading a row of the image."""

    from perception.geometry.profile import depth_profile_kernels

    kernels: Any = depth_profile_kernels
    columns = ((np.arange(COLUMNS) + 0.5) * (intrinsics.width / COLUMNS)).astype(np.int64)
    forward, height, distance = (np.empty(len(slope)) for _ in range(3))
    readings = np.empty(len(slope), dtype=np.int64)
    kernels.scan(
        depth_m,
        intrinsics.fx,
        intrinsics.fy,
        intrinsics.cx,
        intrinsics.cy,
        np.ascontiguousarray(rotation),
        slope,
        columns,
        (float(lateral_m[0]), float(lateral_m[1])),
        (MIN_DEPTH_M, MAX_DEPTH_M),
        MIN_READINGS,
        forward,
        height,
        distance,
        readings,
    )
    return Scan(slope, forward, height, distance, readings)


def _segment(scan: Scan) -> tuple[np.ndarray, np.ndarray, float]:
    """First row and kind of each part of the cross-section, and what the cut costs."""
    from perception.geometry.profile import depth_profile_kernels

    kernels: Any = depth_profile_kernels
    slope, forward, height, distance, readings = (
        scan.slope, scan.forward_m, scan.height_m, scan.depth_m, scan.readings,
    )  # fmt: skip
    noise = DEPTH_SIGMA_PER_M2 * distance**2 / np.sqrt(np.maximum(readings / COLUMNS_PER_READING, 1.0))
    per_depth = forward / np.maximum(distance, 1e-6)
    forward_std = np.hypot(noise * per_depth, PLACE_STD_M)
    height_std = np.hypot(noise * per_depth * slope, PLACE_STD_M)
    first, kind = np.empty(len(slope), dtype=np.int64), np.empty(len(slope), dtype=np.int64)
    count, cost = kernels.segment(
        forward, height, forward_std, height_std, readings, ROWS_PER_READING, FACE_COST, UNKNOWN_COST, first, kind
    )
    return first[:count], kind[:count], cost


def pitch_from_cut(scan: Scan) -> float:
    """The turn under which the cross-section is cut most cheaply into level treads and upright risers, radians.

    Needs no lines, but depth with straight faces. Gravity counts as in `perception.geometry.rounded`: right to
    half a degree, with long tails.
    """
    costs = []
    for turn in CUT_TURNS_RAD:
        cos, sin = math.cos(turn), math.sin(turn)
        forward = np.where(scan.readings > 0, np.maximum(cos * scan.forward_m - sin * scan.height_m, 1e-3), 0.0)
        height = np.where(scan.readings > 0, sin * scan.forward_m + cos * scan.height_m, 0.0)
        slope = np.tan(np.clip(np.arctan(scan.slope) + turn, -1.5, 1.5))
        turned = Scan(slope, forward, height, scan.depth_m, scan.readings)
        costs.append(_segment(turned)[2] + 2.0 * math.log1p((turn / CUT_TURN_STD_RAD) ** 2))
    best = int(np.argmin(costs))
    if not 0 < best < len(costs) - 1:
        return CUT_TURNS_RAD[best]
    left, middle, right = costs[best - 1 : best + 2]
    shift = 0.5 * (left - right) / max(left - 2.0 * middle + right, 1e-9)
    return CUT_TURNS_RAD[best] + shift * (CUT_TURNS_RAD[1] - CUT_TURNS_RAD[0])


def _faces(
    first: np.ndarray,
    kind: np.ndarray,
    scan: Scan,
    omega_m: float,
) -> tuple[np.ndarray, list[int], list[float], list[tuple[int, int]]]:
    """Faces of enough rows, joined where of one kind and place: face of each row, kinds, values, row spans."""
    face = np.full(len(scan.slope), -1)
    kinds: list[int] = []
    values: list[float] = []
    spans: list[tuple[int, int]] = []
    ends = np.append(first[1:], len(scan.slope)).tolist()
    for begin, end, what in zip(first.tolist(), ends, kind.tolist()):
        rows = begin + np.nonzero(scan.readings[begin:end])[0]
        if what == UNKNOWN or len(rows) < MIN_FACE_ROWS:
            continue
        value = median((scan.height_m if what == TREAD else scan.forward_m)[rows])
        if kinds and kinds[-1] == what and abs(values[-1] - value) < omega_m:
            spans[-1] = (spans[-1][0], int(rows[-1]))
        else:
            kinds.append(what)
            values.append(value)
            spans.append((int(rows[0]), int(rows[-1])))
        face[begin:end] = len(kinds) - 1
    return face, kinds, values, spans


def _edges(
    kinds: list[int], values: list[float], spans: list[tuple[int, int]], slope: np.ndarray
) -> tuple[ProfileEdge, ...]:
    """Edges between neighbouring faces that adjoin, and the ends of risers next to which depth says nothing."""
    edges: list[ProfileEdge] = []
    if kinds and kinds[0] == RISER and spans[0][0] > 0:
        edges.append(_foot(values[0], float(slope[spans[0][0]])))
    for near, far in itertools.pairwise(range(len(kinds))):
        last, begin = spans[near][1], spans[far][0]
        gap = begin - last - 1
        hides_tread = kinds[near] == kinds[far] == RISER and gap >= MIN_HIDDEN_ROWS
        apart = gap > MAX_GAP_ROWS
        if kinds[near] == RISER and (apart or hides_tread):
            edges.append(_top(values[near], float(slope[last])))
        if not apart:
            cut = 0.5 * float(slope[last] + slope[begin])
            row = abs(float(slope[begin] - slope[last])) / max(begin - last, 1)
            place = _corner(kinds[near], values[near], kinds[far], values[far], cut, CORNER_MISS_ROWS * row)
            if place is not None:
                edges.append(ProfileEdge(*place, kinds[near], kinds[far]))
        if kinds[far] == RISER and (apart or hides_tread):
            edges.append(_foot(values[far], float(slope[begin])))
    if kinds and kinds[-1] == RISER and spans[-1][1] < len(slope) - 1:
        edges.append(_top(values[-1], float(slope[spans[-1][1]])))
    return tuple(edges)


def _foot(forward_m: float, slope: float) -> ProfileEdge:
    """The lower end of a riser; nothing is known of what lies before it."""
    return ProfileEdge(forward_m, forward_m * slope, UNKNOWN, RISER)


def _top(forward_m: float, slope: float) -> ProfileEdge:
    """The upper end of a riser; nothing is known of what lies behind it."""
    return ProfileEdge(forward_m, forward_m * slope, RISER, UNKNOWN)


def _corner(
    near_kind: int, near: float, far_kind: int, far: float, cut: float, tolerance: float
) -> tuple[float, float] | None:
    """(forward, height) of the edge between two faces that are cut at a slope."""
    if near_kind != far_kind:
        forward, height = (far, near) if near_kind == TREAD else (near, far)
        if abs(height / max(forward, 1e-3) - cut) < tolerance:
            return forward, height
    if near_kind == RISER:
        return near, near * cut
    if abs(cut) < 1e-3 or near / cut <= 0.0:
        return None
    return near / cut, near
