"""Steps and the way the camera hangs, from the blurred cross-section as a whole (`perception.geometry.rounded`).

Used where faces cannot be read one by one: creases rounded over many pixels, depth missing along the lines, gravity
off by degrees or unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from perception.geometry.cross_section import Section, read_nosings
from perception.geometry.line_matching import lateral_extent
from perception.geometry.lines import SCORE_THRESHOLD, LineSlopes, median
from perception.geometry.profile.depth_profile import Scan, scan_profile
from perception.geometry.results import Nosing
from perception.geometry.rounded import RoundedFit, fit_rounded
from perception.geometry.strips.levelling import level_sideways, turn_pitch
from perception.geometry.strips.strip_planes import Faces, LineViews, sample_strips
from stair_env.intrinsics import Intrinsics

SETTLED_RAD = math.radians(0.3)  # a correction sideways after which no second scan is worth its time
MIN_EXPLAINED = 0.78  # share of the rows; below, it is something else
MAX_NOISE = 0.013  # 1/m; 0.3 px at 447 px and 50 mm: what lies farther off than a matcher's waves has another shape
MAX_RISER_STD_M = 0.014  # of any riser; one known no better tells nothing
EDGE_MARGIN_PX = 3.0
MARGIN_CREASES = 1.5  # standard deviations of the blur that are left out on either side of a line


@dataclass(frozen=True)
class RoundedStairs:
    """What the whole cross-section says.

    Attributes:
        fit: faces between the lines.
        nosings: nearest first.
        kinds: index of a given line -> "convex" or "concave".
        camera_to_stair: (3, 3) rotation into (f, l, h), corrected.
        yaw_std_rad: of it about h.
    """

    fit: RoundedFit
    nosings: tuple[Nosing, ...]
    kinds: dict[int, str]
    camera_to_stair: np.ndarray
    yaw_std_rad: float


def measure_rounded(
    lines: np.ndarray,
    views: LineViews,
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
    camera_to_stair: np.ndarray,
    gravity_std_rad: float,
    omega_m: float,
    scan: Scan | None = None,
) -> RoundedStairs | None:
    """Fit a blurred staircase to all of the depth.

    Args:
        lines: (m, 8) rows of `perception.geometry.lines.LINE_FIELDS`, pixels of the depth image, nearest first; weak
            ones (below the paper's score) are left out.
        views: of these lines.
        depth_m: (H, W) float, metres, 0 = no reading.
        intrinsics: of the depth image.
        camera_to_stair: (3, 3) rotation into (f, l, h) from gravity and the lines.
        gravity_std_rad: of gravity, with long tails.
        omega_m: smallest riser and tread that counts, metres.
        scan: the cross-section under this rotation, if it has been scanned.

    Returns:
        None where no staircase explains the depth.
    """
    sure = np.nonzero(lines[:, 6] >= SCORE_THRESHOLD)[0]
    if len(sure) < 2:
        return None
    lines, views = lines[sure], views.chosen(sure)
    first = _fit_once(lines, views, depth_m, intrinsics, camera_to_stair, gravity_std_rad, scan)
    if first is None:
        return None
    found = first
    if not first.settled:  # sideways only: the pitch is found again, about gravity as it was given
        turned = turn_pitch(-first.fit.turn_rad) @ first.camera_to_stair
        again = _fit_once(lines, views, depth_m, intrinsics, turned, gravity_std_rad)
        if again is None:
            return None
        found = again
    fit, rotation, covariance, used = found.fit, found.camera_to_stair, found.side_cov, found.fit.line
    if fit.explained < MIN_EXPLAINED or fit.noise > MAX_NOISE:
        return None
    slope, slope_std = views.slopes(rotation)
    order = np.append(np.arange(len(used)), 0)
    section = Section(fit.kind, fit.value, fit.covariance, order, order)
    angle_cov = np.diag([float(covariance[0, 0]), fit.turn_std_rad**2, float(covariance[1, 1])])
    faces = Faces(fit.kind, fit.value, np.sqrt(np.maximum(np.diag(fit.covariance), 0.0)), rotation, angle_cov)
    seen_alone = np.zeros(len(used), bool)  # here every face is fitted, and none is read from its lines alone
    seen = LineSlopes(slope[used], slope_std[used], seen_alone)
    nosings, kinds = read_nosings(section, fit.direction, seen, faces, omega_m)
    nosings = tuple(_without_guesses(nosing) for nosing in nosings)
    yaw_std = math.sqrt(max(float(covariance[1, 1]), 0.0))
    edges = {int(sure[used[index]]): kind for index, kind in kinds.items()}
    return RoundedStairs(fit, nosings, edges, rotation, yaw_std)


def _without_guesses(nosing: Nosing) -> Nosing:
    """A nosing without a riser that is hardly known: the flight's likeness alone would tell it, not this frame."""
    if nosing.riser_std_m is not None and nosing.riser_std_m > MAX_RISER_STD_M:
        return replace(nosing, riser_m=None, riser_std_m=None)
    return nosing


@dataclass(frozen=True)
class _Fitted:
    """One scan's fit, the rotation that goes with it, the covariance (2, 2) of that about f and h, and whether the scan
    was level enough sideways."""

    fit: RoundedFit
    camera_to_stair: np.ndarray
    side_cov: np.ndarray
    settled: bool


def _fit_once(
    lines: np.ndarray,
    views: LineViews,
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
    camera_to_stair: np.ndarray,
    gravity_std_rad: float,
    scan: Scan | None = None,
) -> _Fitted | None:
    """Scan the cross-section, fit it, and level the camera by what it shows; None where no staircase explains it."""
    if scan is None:
        lateral = lateral_extent(lines, depth_m, intrinsics, camera_to_stair)
        middle_x = median((lines[:, 0] + lines[:, 2]) / 2.0)
        scan = scan_profile(depth_m, intrinsics, camera_to_stair, middle_x, lateral)
    fit = fit_rounded(scan, *views.slopes(camera_to_stair), gravity_std_rad, intrinsics.height)
    if fit is None:
        return None
    pitched = turn_pitch(fit.turn_rad) @ camera_to_stair
    margin = max(EDGE_MARGIN_PX, MARGIN_CREASES * fit.crease_px)
    strips = sample_strips(lines[fit.line], depth_m, intrinsics, margin)
    levelled, covariance = level_sideways(strips, fit.kind, pitched, views.chosen(fit.line), gravity_std_rad)
    return _Fitted(fit, levelled, covariance, float(np.abs(levelled - pitched).max()) < SETTLED_RAD)
