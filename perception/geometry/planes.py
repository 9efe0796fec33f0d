"""From stair lines and depth to step width and step height ("Acquisition of geometric stair parameters").

Frames, all right-handed and centred in the colour imager: *camera* (x right, y down, z forward), *level* (the same
after undoing roll and pitch: y along gravity, z horizontal), *stair* (f forward along the walking direction, l left,
h up). Two methods give the same result type: "planes", the default, which fits treads and risers
(`perception.geometry.strips.strip_planes`), and "paper", equations 7 to 9 to the letter (`perception.geometry.paper`).
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np

from perception.geometry.cross_section import (
    DOWN,
    Section,
    build_section,
    find_drops,
    read_nosings,
    walking_direction,
)
from perception.geometry.line_matching import CheckedLines, check_lines
from perception.geometry.lines import LineSlopes, median
from perception.geometry.profile.depth_jumps import locate_drops
from perception.geometry.reading import Frame, Geometry, Reading, camera_yaw, section_misfit, with_gravity
from perception.geometry.reconcile import is_sound, reconcile, without_gravity
from perception.geometry.results import steps_of
from perception.geometry.strips.strip_labels import RISER, UNKNOWN
from perception.geometry.strips.strip_planes import Faces, LineViews, fit_faces, sample_strips
from stair_env.intrinsics import Intrinsics

OMEGA_M = 0.05  # the paper's threshold: smaller widths and heights are noise of one and the same face
MIN_SUPPORT = 2  # cell predictions behind a line
MIN_CONFIRMED = {1: 2, -1: 1}  # lines that both the detector and depth show; the last step down has a single one
LINE_JITTER_PX = 0.4  # of a whole detected line, in pixels of the 512 x 512 image
PIECE_JITTER_PX = 4.0  # of one cell's prediction, added to it over the number of cells: measured on 336 frames
GRAVITY_STD_RAD = math.radians(0.7)  # fused attitude on a walking robot, with some margin
DROP_JITTER_PX = 0.4  # of a line that both the detector and depth have placed
DROP_SHARE = 0.4  # of depth in that place, where the two agree
MISSING_LINE_JITTER_PX = 3.0  # of a line that only depth has placed, and so says nothing that depth does not
MAX_DISAGREEMENT_PX = 2.5  # of the two; where they are farther apart depth alone counts
UNCONFIRMED_FACTOR = 8.0  # on the jitter of a line near which depth shows no jump: it may be 4 px off
STRIP_IMAGE_WIDTH_PX = 640.0
UNKNOWN_PITCHES_RAD = tuple(math.radians(degrees) for degrees in (-5.0, -25.0, -45.0, -65.0))  # head up positive
MAX_YAW_RAD = math.radians(70.0)


def attitude_angles(gravity: np.ndarray) -> tuple[float, float]:
    """(pitch, roll) by the paper's equation 8, radians; head up and right side down are positive.

    Args:
        gravity: (3,) accelerometer reading at rest, camera frame, any unit; (0, -9.8, 0) when level.
    """
    x, _, z = np.asarray(gravity, dtype=np.float64) / np.linalg.norm(gravity)
    return math.asin(float(np.clip(z, -1.0, 1.0))), math.asin(float(np.clip(-x, -1.0, 1.0)))


def camera_to_level(gravity: np.ndarray) -> np.ndarray:
    """(3, 3) rotation that undoes roll and pitch and keeps the heading of the optical axis.

    Args:
        gravity: (3,) accelerometer reading at rest, camera frame, any unit.
    """
    down = -np.asarray(gravity, dtype=np.float64) / np.linalg.norm(gravity)
    axis = np.array([0.0, 0.0, 1.0])
    if abs(down[2]) > 0.999:  # looks straight down or up: heading is that of the image's upper edge
        axis = np.array([0.0, -math.copysign(1.0, -down[2]), 0.0])
    forward = axis - (axis @ down) * down
    forward /= np.linalg.norm(forward)
    return np.stack([np.cross(down, forward), down, forward])


def level_to_stair(yaw_rad: float) -> np.ndarray:
    """(3, 3) rotation from the level frame (right, down, forward) to (f, l, h), for a camera that looks to the right
    of the walking direction by yaw_rad."""
    sin, cos = math.sin(yaw_rad), math.cos(yaw_rad)
    return np.array([[-sin, 0.0, cos], [-cos, 0.0, -sin], [0.0, -1.0, 0.0]])


def line_normals(lines: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """(m, 3) unit normals, camera frame, of the planes through the camera and the image lines; they point down.

    Args:
        lines: (m, 8) rows of `perception.geometry.lines.LINE_FIELDS`, pixels.
        intrinsics: of that image.
    """
    # y = k x + b in pixels, with x = fx X / Z + cx and y = fy Y / Z + cy, is a plane through the origin.
    k, b = lines[:, 4], lines[:, 5]
    fx, fy, cx, cy = intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy
    normals = np.stack([-k * fx, np.full(len(k), fy), cy - k * cx - b], axis=1)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def yaw_from_lines(normals_level: np.ndarray, lengths: np.ndarray) -> float:
    """Yaw of the camera relative to the stairs from horizontal lines, no depth needed.

    A horizontal line in space that projects to an image line is the intersection of that line's plane through the
    camera with the horizontal, so that its direction follows from gravity alone.

    Args:
        normals_level: (m, 3) plane normals in the level frame.
        lengths: (m,) of the lines in the image; the weight of each.

    Returns:
        Weighted median, radians, positive when the camera looks to the right of the walking direction.
    """
    direction = np.stack([normals_level[:, 2], -normals_level[:, 0]], axis=1)  # (X, Z) of n x up
    strength = np.linalg.norm(direction, axis=1)
    direction = np.where(direction[:, :1] < 0.0, -direction, direction)
    yaw = np.arctan2(direction[:, 1], np.maximum(direction[:, 0], 1e-9))
    order = np.argsort(yaw)
    weight = np.cumsum((strength * lengths)[order])
    return float(yaw[order][np.searchsorted(weight, weight[-1] / 2.0)])


def measure_stairs(
    lines: np.ndarray,
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
    gravity: np.ndarray | None,
    *,
    omega_m: float = OMEGA_M,
    gravity_std_rad: float = GRAVITY_STD_RAD,
    refine_gravity: bool = True,
) -> Geometry:
    """Cross-section of the staircase by fitting its treads and risers.

    Args:
        lines: (m, 8) rows of `perception.geometry.lines.LINE_FIELDS`, pixels of the depth image, any order.
        depth_m: (H, W) float, metres, 0 = no reading.
        intrinsics: of the depth image.
        gravity: (3,) accelerometer reading at rest, camera frame; None when unknown: it is found from depth.
        omega_m: smallest width and height that counts, metres.
        gravity_std_rad: standard deviation of the gravity direction.
        refine_gravity: whether depth may overrule gravity; False where attitude is known to half a degree, as on a
            robot. There the faces alone count: on 12 flights widths were then off by 2 instead of 24 mm.

    Returns:
        Geometry whose kinds have one entry per row of `lines`.
    """
    used = np.nonzero(lines[:, 7] >= MIN_SUPPORT)[0] if len(lines) else np.empty(0, dtype=int)
    unknown = ("unknown",) * len(lines)
    if len(used) == 0:
        return Geometry(kinds=unknown, reason="no stair lines")
    used = used[np.argsort(-_height_at_middle(lines[used]))]
    frame = Frame(lines, used, depth_m, intrinsics, omega_m)
    read = functools.partial(_read_faces, gravity_std_rad=gravity_std_rad)
    if gravity is None:
        return without_gravity(frame, _views(frame), _guesses(frame), read)
    level = camera_to_level(gravity)
    yaw = yaw_from_lines(line_normals(frame.chosen, intrinsics) @ level.T, _lengths(frame.chosen))
    if abs(yaw) > MAX_YAW_RAD:
        return Geometry(kinds=unknown, reason="the lines run away from the camera")
    guess = level_to_stair(yaw) @ level
    up = -level[1]
    reading = read(frame, guess)
    if not refine_gravity or is_sound(reading, up):
        return with_gravity(reading, up)
    return reconcile(frame, reading, _views(frame), guess, up, read)


def _views(frame: Frame) -> LineViews:
    """How the camera sees the chosen lines."""
    jitter_px = _jitter_px(frame.chosen, frame.intrinsics)
    return _line_views(frame.chosen, frame.intrinsics, jitter_px, _lengths(frame.chosen))


def _guesses(frame: Frame) -> list[np.ndarray]:
    """(3, 3) rotations into (f, l, h) for several pitches of a camera that is held upright."""
    guesses = []
    for pitch in UNKNOWN_PITCHES_RAD:
        level = camera_to_level(np.array([0.0, -math.cos(pitch), math.sin(pitch)]))
        yaw = yaw_from_lines(line_normals(frame.chosen, frame.intrinsics) @ level.T, _lengths(frame.chosen))
        if abs(yaw) <= MAX_YAW_RAD:
            guesses.append(level_to_stair(yaw) @ level)
    return guesses


def _read_faces(frame: Frame, guess: np.ndarray, gravity_std_rad: float) -> Reading:
    """The steps from faces that are read one by one, between lines that depth confirms."""
    depth_m, intrinsics, omega_m = frame.depth_m, frame.intrinsics, frame.omega_m
    checked = check_lines(frame.chosen, depth_m, intrinsics, guess, omega_m, MIN_SUPPORT)
    chosen = checked.lines
    if len(chosen) == 0:
        return Reading(frame.nothing("depth shows no edge where the lines are"), guess, scan=checked.profile)
    views, faces = _fit(checked, depth_m, intrinsics, guess, gravity_std_rad)
    faces = _without_fattening(faces, checked.ends_riser, omega_m)
    section = build_section(faces, views, _thickness(chosen, intrinsics), omega_m)
    direction = walking_direction(section, omega_m)
    if direction == 0:
        return Reading(frame.nothing("no height differences between the lines"), guess, scan=checked.profile)
    if checked.confirmed.sum() < MIN_CONFIRMED[direction]:
        return Reading(frame.nothing("depth confirms too few of the lines"), guess, scan=checked.profile)
    slopes = views.slopes(faces.camera_to_stair)
    if direction == DOWN:
        slopes = _sharpen(section, slopes, chosen, faces, depth_m, intrinsics)
    seen = LineSlopes(*slopes, checked.confirmed)
    nosings, edge_kinds = read_nosings(section, direction, seen, faces, omega_m)
    edges = {int(checked.source[index]): kind for index, kind in edge_kinds.items() if checked.source[index] >= 0}
    geometry = Geometry(
        direction,
        nosings,
        steps_of(nosings),
        camera_yaw(faces.camera_to_stair),
        math.sqrt(float(faces.angle_cov[2, 2])),
        frame.kinds(edges),
        "" if any(nosing.riser_m for nosing in nosings) else "no complete riser in view",
    )
    misfit = section_misfit(section, slopes[0], checked.profile, faces.camera_to_stair @ guess.T)
    return Reading(geometry, faces.camera_to_stair, misfit, checked.profile)


def _fit(
    checked: CheckedLines, depth_m: np.ndarray, intrinsics: Intrinsics, guess: np.ndarray, gravity_std_rad: float
) -> tuple[LineViews, Faces]:
    """Faces between lines."""
    lines = checked.lines
    pixel = max(intrinsics.width, intrinsics.height) / 512.0
    jitter_px = np.where(checked.source >= 0, _jitter_px(lines, intrinsics), MISSING_LINE_JITTER_PX * pixel)
    views = _line_views(lines, intrinsics, jitter_px, checked.own_length)
    return views, fit_faces(sample_strips(lines, depth_m, intrinsics), guess, views, gravity_std_rad)


def _without_fattening(faces: Faces, ends_riser: np.ndarray, omega_m: float) -> Faces:
    """Forget strips that show nothing but the riser below them, where that is known to end.

    Args:
        faces: of the m + 1 strips.
        ends_riser: (m,) whether a riser ends at the line above each strip but the last.
        omega_m: faces of one kind nearer than this are one.
    """
    both_risers = (faces.kind[:-1] == RISER) & (faces.kind[1:] == RISER)
    same = both_risers & (np.abs(np.diff(faces.value)) < omega_m) & ends_riser
    kind, value = faces.kind.copy(), faces.value.copy()
    kind[1:][same], value[1:][same] = UNKNOWN, 0.0
    return replace(faces, kind=kind, value=value)


def _jitter_px(lines: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """(m,) standard deviation of the place of detected lines (m, 8), pixels."""
    pixel = max(intrinsics.width, intrinsics.height) / 512.0
    return np.asarray(np.hypot(LINE_JITTER_PX, PIECE_JITTER_PX / np.maximum(lines[:, 7], 1.0)) * pixel)


def _lengths(lines: np.ndarray) -> np.ndarray:
    """(m,) of the lines (m, 8) along x, pixels."""
    return np.asarray(lines[:, 2] - lines[:, 0])


def _thickness(lines: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """(m + 1,) thickness of the strips between (m, 8) lines, nearest first, in pixels of a 640 pixels wide image."""
    gaps = -np.diff(_height_at_middle(lines)) * STRIP_IMAGE_WIDTH_PX / intrinsics.width
    return np.concatenate([[np.inf], gaps, [np.inf]])


def _sharpen(
    section: Section,
    slopes: tuple[np.ndarray, np.ndarray],
    lines: np.ndarray,
    faces: Faces,
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
) -> tuple[np.ndarray, np.ndarray]:
    """Move the lines of descending nosings to where depth jumps; slopes as `LineViews.slopes` gives them."""
    treads, far = find_drops(section)
    if len(treads) == 0:
        return slopes
    low, high = lines[section.line[treads]], lines[section.last_line[treads]]
    drops = locate_drops(low, high, section.value[treads], far, depth_m, intrinsics, faces.camera_to_stair)
    pixel = max(intrinsics.width, intrinsics.height) / 512.0
    share = np.where(np.abs(drops.offset_px) < MAX_DISAGREEMENT_PX * pixel, DROP_SHARE, 1.0)
    moved = low.copy()
    moved[:, 5] -= np.where(drops.found, share * drops.offset_px, 0.0)
    at_drop = _line_views(moved, intrinsics, DROP_JITTER_PX * pixel, moved[:, 2] - moved[:, 0])
    slope_at_drop = at_drop.slopes(faces.camera_to_stair)
    value, std = slopes[0].copy(), slopes[1].copy()
    index = section.line[treads]
    value[index] = np.where(drops.found, slope_at_drop[0], value[index])
    std[index] = np.where(drops.found, slope_at_drop[1], UNCONFIRMED_FACTOR * std[index])
    return value, std


def _line_views(
    lines: np.ndarray, intrinsics: Intrinsics, jitter_px: np.ndarray | float, own_length: np.ndarray
) -> LineViews:
    """Viewing planes and middle rays of (m, 8) lines whose place in the image is uncertain by jitter_px, and whose
    direction was seen over own_length (m,) pixels."""
    x = (lines[:, 0] + lines[:, 2]) / 2.0
    y = lines[:, 4] * x + lines[:, 5]
    rays = np.stack([(x - intrinsics.cx) / intrinsics.fx, (y - intrinsics.cy) / intrinsics.fy, np.ones_like(x)], axis=1)
    jittered = rays.copy()
    jittered[:, 1] += jitter_px / intrinsics.fy
    direction_std = jitter_px * 2.5 / np.maximum(own_length, 1.0)  # sqrt(12 / 2): a line of many cells
    return LineViews(line_normals(lines, intrinsics), direction_std, rays, jittered)


def _height_at_middle(lines: np.ndarray) -> np.ndarray:
    """(m,) image y of every line at one common column, where most of them are."""
    x = median((lines[:, 0] + lines[:, 2]) / 2.0)
    return lines[:, 4] * x + lines[:, 5]
