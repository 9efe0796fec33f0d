"""What passes between the parts of `perception.geometry`: a frame to be measured, and one attempt at it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from perception.geometry.cross_section import Section
from perception.geometry.lines import median
from perception.geometry.profile.depth_profile import Scan
from perception.geometry.results import Nosing, StepMeasurement
from perception.geometry.strips.levelling import in_section
from perception.geometry.strips.strip_labels import TREAD, UNKNOWN
from stair_env.intrinsics import Intrinsics

MIN_CORRECTION_RAD = math.radians(1.0)  # below, gravity counts as right: the faces' own fit has taken it into account


@dataclass(frozen=True)
class Geometry:
    """What one frame says about the staircase (see `perception.geometry.results.StairEstimate` for the fields).

    `up` is the direction against gravity that was used in the end, (3,) in the camera frame, or None.
    """

    direction: int = 0
    nosings: tuple[Nosing, ...] = ()
    steps: tuple[StepMeasurement, ...] = ()
    yaw_rad: float = 0.0
    yaw_std_rad: float = 0.0
    kinds: tuple[str, ...] = ()
    reason: str = ""
    up: np.ndarray | None = None
    gravity_correction_rad: float = 0.0
    gravity_source: str = "imu"
    crease_px: float = 0.0


@dataclass(frozen=True)
class Frame:
    """What is measured.

    Attributes:
        lines: (m, 8) rows of `perception.geometry.lines.LINE_FIELDS`, pixels of the depth image, any order.
        used: (n,) which of them are in use, nearest first.
        depth_m: (H, W) float, metres, 0 = no reading.
        intrinsics: of the depth image.
        omega_m: smallest width and height that counts, metres.
    """

    lines: np.ndarray
    used: np.ndarray
    depth_m: np.ndarray
    intrinsics: Intrinsics
    omega_m: float

    @property
    def chosen(self) -> np.ndarray:
        """(n, 8) the lines in use."""
        return self.lines[self.used]

    def kinds(self, edges: dict[int, str]) -> tuple[str, ...]:
        """The kind of every line, from the kinds of those lines in use that are edges."""
        kinds = ["unknown"] * len(self.lines)
        for index, kind in edges.items():
            kinds[self.used[index]] = kind
        return tuple(kinds)

    def nothing(self, reason: str) -> Geometry:
        """The answer when there is no staircase to measure."""
        return Geometry(kinds=self.kinds({}), reason=reason)


@dataclass(frozen=True)
class Reading:
    """One attempt at a frame.

    Attributes:
        geometry: its answer.
        camera_to_stair: (3, 3) rotation into (f, l, h) that goes with it.
        misfit: `section_misfit` of it, 1 / m; infinite without an answer.
        scan: the cross-section that it rests on, in the (f, l, h) that were guessed; None where there was none.
    """

    geometry: Geometry
    camera_to_stair: np.ndarray
    misfit: float = math.inf
    scan: Scan | None = None


def with_gravity(reading: Reading, up: np.ndarray | None) -> Geometry:
    """A reading's answer, with what it says about gravity.

    Args:
        reading: the attempt that counts.
        up: (3,) direction that the accelerometer gave, camera frame; None when there was none.
    """
    found = reading.camera_to_stair[2]
    if up is None:
        return replace(reading.geometry, up=found, gravity_source="depth")
    correction = angle_between(found, up)
    source = "refined" if correction > MIN_CORRECTION_RAD else "imu"
    return replace(reading.geometry, up=found, gravity_correction_rad=correction, gravity_source=source)


def angle_between(one: np.ndarray, other: np.ndarray) -> float:
    """Between two unit vectors (3,), radians."""
    return math.atan2(float(np.linalg.norm(np.cross(one, other))), float(one @ other))


def camera_yaw(camera_to_stair: np.ndarray) -> float:
    """Heading of the optical axis relative to the walking direction, positive to the right."""
    f, left, _ = camera_to_stair[:, 2]
    return math.atan2(-float(left), float(f))


def section_misfit(section: Section, line_slope: np.ndarray, scan: Scan, scan_to_stair: np.ndarray) -> float:
    """How far, on average, what is seen between the lines lies from what the faces predict.

    Args:
        section: adjusted.
        line_slope: (m,) height per forward metre at which the lines are seen.
        scan: the cross-section as it was seen.
        scan_to_stair: (3, 3) from the scan's (f, l, h) to the section's.

    Returns:
        Median over the rows of known faces, in inverse depth, 1 / m; infinite where there are none.
    """
    forward, height = in_section(scan.forward_m, scan.height_m, scan_to_stair)
    between = line_slope[section.line[:-1]]
    seen = (scan.readings > 0) & (forward > 0.0)
    if not seen.any() or len(between) < 2:
        return math.inf
    forward, height, depth = forward[seen], height[seen], scan.depth_m[seen]
    slope = height / forward
    face = np.searchsorted(between, slope)
    inner = (face > 0) & (face < len(between)) & (section.kind[face] != UNKNOWN)
    if not inner.any():
        return math.inf
    face, slope, forward, depth = face[inner], slope[inner], forward[inner], depth[inner]
    tread = section.kind[face] == TREAD
    flat = np.where(np.abs(slope) > 1e-3, slope, -1e-3)
    predicted = np.where(tread, section.value[face] / flat, section.value[face])
    miss = np.abs(forward / np.where(predicted > 1e-3, predicted, 1e-3) - 1.0) / depth
    return median(miss)
