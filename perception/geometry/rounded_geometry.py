"""Steps and the way the camera hangs, from the blurred cross-section as a whole (`perception.geometry.rounded`).

Used where faces cannot be read one by one: creases rounded over many pixels, depth missing along the lines, gravity
off by degrees or unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from perception.geometry.cross_section import Section, read_nosings
from perception.geometry.line_matching import lateral_extent
from perception.geometry.lines import SCORE_THRESHOLD, median
from perception.geometry.profile.depth_profile import scan_profile
from perception.geometry.results import Nosing
from perception.geometry.rounded import RoundedFit, fit_rounded
from perception.geometry.strips.levelling import level_sideways, turn_pitch
from perception.geometry.strips.strip_planes import Faces, LineViews, sample_strips
from stair_env.intrinsics import Intrinsics

SCANS = 2  # the cross-section is scanned again once roll and yaw are known better
SETTLED_RAD = math.radians(0.3)  # a correction sideways after which no scan is worth its time
MIN_EXPLAINED = 0.78  # share of the rows; below, it is something else
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

    Returns:
        None where no staircase explains the depth.
    """
    sure = np.nonzero(lines[:, 6] >= SCORE_THRESHOLD)[0]
    if len(sure) < 2:
        return None
    lines, views = lines[sure], views.chosen(sure)
    rotation, yaw_std = camera_to_stair, 0.0
    for scan in range(SCANS):
        lateral = lateral_extent(lines, depth_m, intrinsics, rotation)
        middle_x = median((lines[:, 0] + lines[:, 2]) / 2.0)
        profile = scan_profile(depth_m, intrinsics, rotation, middle_x, lateral)
        fit = fit_rounded(profile, *views.slopes(rotation), gravity_std_rad, intrinsics.height)
        if fit is None:
            return None
        pitched = turn_pitch(fit.turn_rad) @ rotation
        used = fit.line
        margin = max(EDGE_MARGIN_PX, MARGIN_CREASES * fit.crease_px)
        strips = sample_strips(lines[used], depth_m, intrinsics, margin)
        levelled, covariance = level_sideways(strips, fit.kind, pitched, views.chosen(used), gravity_std_rad)
        yaw_std = math.sqrt(max(float(covariance[1, 1]), 0.0))
        settled = float(np.abs(levelled - pitched).max()) < SETTLED_RAD
        if settled or scan == SCANS - 1:
            break
        # Sideways only: the pitch is found again, about gravity as it was given.
        rotation = turn_pitch(-fit.turn_rad) @ levelled
    if fit is None or fit.explained < MIN_EXPLAINED:
        return None
    rotation = levelled
    slope, slope_std = views.slopes(rotation)
    order = np.append(np.arange(len(used)), 0)
    section = Section(fit.kind, fit.value, fit.covariance, order, order)
    angle_cov = np.diag([covariance[0, 0], fit.turn_std_rad**2, covariance[1, 1]])
    faces = Faces(fit.kind, fit.value, np.sqrt(np.maximum(np.diag(fit.covariance), 0.0)), rotation, angle_cov)
    nosings, kinds = read_nosings(section, fit.direction, (slope[used], slope_std[used]), faces, omega_m)
    return RoundedStairs(
        fit, nosings, {int(sure[used[index]]): kind for index, kind in kinds.items()}, rotation, yaw_std
    )
