"""Treads and risers from depth: planes between the detected lines, fitted together.

Depth is worst where stair lines are: holes and flying pixels sit on the edges. It is good between them. The lines cut
the picture into strips, and each strip shows one face: a tread (its height is constant) or a riser (its forward
distance is). All faces of a staircase share one orientation, so that three small angles, corrections to the
gravity-levelled frame and to the yaw that the lines give, are solved once for all points by robust least squares,
with the accelerometer's answer as a prior. What remains per face is one number and its standard deviation.

Everything is a batch of (strips, points) arrays; coordinates are (f, l, h): forward along the walking direction of the
stairs, left, and up from the camera, metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from perception.geometry.lines import median
from perception.geometry.strips.strip_labels import RISER, TREAD, Candidate, choose_kinds
from stair_env.intrinsics import Intrinsics

COLUMN_BANDS = 27  # samples across a strip: the paper's nine sampling points, three columns each
ROW_SAMPLES = 8  # samples between two lines
EDGE_MARGIN_PX = 3.0  # flying pixels (about 2) and jitter of the line (about 1)
EDGE_MARGIN_FRACTION = 0.25  # of a strip too thin for the whole margin
OUTER_STRIP = 0.22  # height of the strips beyond the first and last line, fraction of the image height
MIN_OVERLAP_PX = 16.0
MIN_DEPTH_M, MAX_DEPTH_M = 0.15, 6.0

DEPTH_SIGMA_PER_M2 = 0.0036  # RMS depth error of the D435i at 1 m, grows with Z^2: 0.08 px / (447 px * 0.05 m)
MAX_NOISE = 2.5  # times that; matched depth and the error model have 1.8 and 2.1 (medians of 12 frames)
MEDIAN_OF_NORMAL = 0.6745  # of the absolute values, in standard deviations
DEPTH_FLOOR_M = 0.004  # unevenness of real treads and quantised disparity
PATCH_PX = 28.0  # side of an image patch that counts as one reading: stereo matching correlates its pixels
PATCH_IMAGE_WIDTH_PX = 640.0  # of the image for which PATCH_PX holds
ROBUST_CUT = 3.0  # residuals beyond this many standard deviations carry no weight
MIN_POINTS = 24
ITERATIONS = 2
FACE_SLOPE_STD_RAD = math.radians(0.5)  # by which the pitches that good faces tell differ, beside their noise
MIN_TREADS_TO_COMPARE = 3  # of which one may be the floor, and slope
LINE_GATE_RAD = 0.02  # a line whose direction is farther from the others' says nothing about yaw


@dataclass(frozen=True)
class Strips:
    """Points between neighbouring lines, K strips of N points, nearest strip first.

    Attributes:
        rays: (K, N, 3) directions in the camera frame, z = 1.
        depth_m: (K, N) distance along the optical axis; 0 where there is no reading.
        ok: (K, N) whether the point counts.
        points_per_reading: (K,) points that together say as much as one independent reading.
        noise: of this frame's depth, in units of DEPTH_SIGMA_PER_M2.
    """

    rays: np.ndarray
    depth_m: np.ndarray
    ok: np.ndarray
    points_per_reading: np.ndarray
    noise: float = 1.0


@dataclass(frozen=True)
class LineViews:
    """How the camera sees the m lines between the strips.

    Attributes:
        normals: (m, 3) unit normals, camera frame, of the planes through the camera and each line.
        direction_std: (m,) standard deviation of each line's direction in the image, radians.
        rays: (m, 3) through the middle of each line, z = 1.
        jittered_rays: (m, 3) the same one standard deviation of the line's place lower in the image.
    """

    normals: np.ndarray
    direction_std: np.ndarray
    rays: np.ndarray
    jittered_rays: np.ndarray

    def chosen(self, index: np.ndarray) -> LineViews:
        """Some of them."""
        return LineViews(self.normals[index], self.direction_std[index], self.rays[index], self.jittered_rays[index])

    def slopes(self, camera_to_stair: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Height per forward metre of each line, (m,), and its standard deviation (m,)."""
        middle, jittered = self.rays @ camera_to_stair.T, self.jittered_rays @ camera_to_stair.T
        slope = middle[:, 2] / np.maximum(middle[:, 0], 1e-3)
        return slope, np.abs(jittered[:, 2] / np.maximum(jittered[:, 0], 1e-3) - slope)


@dataclass(frozen=True)
class Faces:
    """What the strips show.

    Attributes:
        kind: (K,) UNKNOWN, TREAD or RISER.
        value: (K,) height of a tread or forward distance of a riser, relative to the camera, metres.
        std: (K,) standard deviation of `value`, metres.
        camera_to_stair: (3, 3) rotation into (f, l, h), refined.
        angle_cov: (3, 3) covariance of the remaining rotation about f, l, h, rad^2.
    """

    kind: np.ndarray
    value: np.ndarray
    std: np.ndarray
    camera_to_stair: np.ndarray
    angle_cov: np.ndarray


def depth_std(depth_m: np.ndarray | float) -> np.ndarray:
    """Standard deviation of a D435i depth reading, metres; any shape."""
    return DEPTH_SIGMA_PER_M2 * np.square(depth_m)


def sample_strips(
    lines: np.ndarray, depth_m: np.ndarray, intrinsics: Intrinsics, margin_px: float = EDGE_MARGIN_PX
) -> Strips:
    """Read the depth between neighbouring lines, and beyond the first and the last.

    Args:
        lines: (m, 8) rows of `perception.geometry.lines.LINE_FIELDS` in pixels of the depth image, nearest (lowest)
            first.
        depth_m: (H, W) float, metres, 0 = no reading.
        intrinsics: of the depth image.
        margin_px: how far from the lines depth is read, as far as a strip is not too thin for that.

    Returns:
        Strips with K = m + 1.
    """
    height = depth_m.shape[0]
    below, above = np.arange(-1, len(lines)), np.arange(0, len(lines) + 1)
    low_line, high_line = lines[np.maximum(below, 0)], lines[np.minimum(above, len(lines) - 1)]
    x = _columns(low_line, high_line)  # (K, C)
    y_low = low_line[:, 4:5] * x + low_line[:, 5:6]
    y_high = high_line[:, 4:5] * x + high_line[:, 5:6]
    y_low[0] = np.minimum(y_high[0] + OUTER_STRIP * height, height)
    y_high[-1] = np.maximum(y_low[-1] - OUTER_STRIP * height, 0.0)
    gap = y_low - y_high
    margin = np.minimum(margin_px, EDGE_MARGIN_FRACTION * gap)
    t = (np.arange(ROW_SAMPLES) + 0.5) / ROW_SAMPLES
    y = (y_high + margin)[:, :, None] + (gap - 2.0 * margin)[:, :, None] * t
    return _read(x, y, gap, depth_m, intrinsics)


def _columns(low_line: np.ndarray, high_line: np.ndarray) -> np.ndarray:
    """(K, C) image columns spread evenly over what both lines of a strip span."""
    start = np.maximum(low_line[:, 0], high_line[:, 0])
    end = np.minimum(low_line[:, 2], high_line[:, 2])
    # Lines side by side: follow the longer one and extrapolate the other.
    apart = end - start < MIN_OVERLAP_PX
    longer = np.where(
        (low_line[:, 2] - low_line[:, 0] >= high_line[:, 2] - high_line[:, 0])[:, None], low_line, high_line
    )
    start, end = np.where(apart, longer[:, 0], start), np.where(apart, longer[:, 2], end)
    t = (np.arange(COLUMN_BANDS) + 0.5) / COLUMN_BANDS
    return start[:, None] + (end - start)[:, None] * t


def _read(x: np.ndarray, y: np.ndarray, gap: np.ndarray, depth_m: np.ndarray, intrinsics: Intrinsics) -> Strips:
    """Depth and rays at columns (K, C) and rows (K, C, S) between lines that are gap (K, C) pixels apart."""
    rows, columns = depth_m.shape
    u = np.broadcast_to(x[:, :, None], y.shape).astype(np.int32)
    v = np.floor(y).astype(np.int32)
    inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows) & (gap > 1.0)[:, :, None]
    u, v = np.clip(u, 0, columns - 1), np.clip(v, 0, rows - 1)
    depth = depth_m[v, u].astype(np.float64)
    ok = inside & (depth > MIN_DEPTH_M) & (depth < MAX_DEPTH_M)  # NaN compares false
    depth = np.where(ok, depth, 0.0)
    rays = np.empty((*y.shape, 3))
    rays[..., 0] = (u + 0.5 - intrinsics.cx) / intrinsics.fx
    rays[..., 1] = (v + 0.5 - intrinsics.cy) / intrinsics.fy
    rays[..., 2] = 1.0
    count = len(x)
    patch = PATCH_PX * columns / PATCH_IMAGE_WIDTH_PX
    across = np.maximum((x[:, -1] - x[:, 0]) / patch, 1.0)
    along = np.maximum(np.maximum(gap, 0.0).mean(axis=1) / patch, 1.0)
    points_per_reading = np.maximum(COLUMN_BANDS * ROW_SAMPLES / (across * along), 1.0)
    return Strips(rays.reshape(count, -1, 3), depth.reshape(count, -1), ok.reshape(count, -1), points_per_reading)


def fit_faces(strips: Strips, camera_to_stair: np.ndarray, views: LineViews, gravity_std_rad: float) -> Faces:
    """Which face each strip shows and where it lies, with one orientation for all.

    Args:
        strips: K sampled strips.
        camera_to_stair: (3, 3) first guess of the rotation into (f, l, h), from gravity and the lines' yaw.
        views: of the K - 1 lines between the strips.
        gravity_std_rad: how far to trust the gravity vector.

    Returns:
        Faces.
    """
    rotation = np.array(camera_to_stair, dtype=np.float64)
    strips = replace(strips, noise=_noise(strips, rotation))
    turned = np.zeros(3)
    cov = np.diag([gravity_std_rad**2, gravity_std_rad**2, 0.1**2])
    fit = _fit_each(strips, rotation, views)
    for _ in range(ITERATIONS):
        if not fit.kind.any():
            break
        step, cov = _solve_rotation(strips, fit, rotation, views, turned, gravity_std_rad)
        rotation = _small_rotation(step) @ rotation
        turned = turned + step
        fit = _fit_each(strips, rotation, views)
    return Faces(fit.kind, np.where(fit.kind > 0, fit.value, 0.0), fit.std, rotation, cov)


@dataclass(frozen=True)
class _Fit:
    """Strips explained as treads or risers under one orientation; kind, value, std (K,) as in `Faces`."""

    kind: np.ndarray
    value: np.ndarray
    std: np.ndarray


def _fit_each(strips: Strips, rotation: np.ndarray, views: LineViews) -> _Fit:
    """Explain each strip as a tread and as a riser, and keep what fits it and its neighbours."""
    tread, riser = explain_strips(strips, rotation, ROW_SAMPLES)
    enough = strips.ok.sum(axis=1) >= MIN_POINTS
    kind = choose_kinds(tread, riser, enough, *views.slopes(rotation))
    is_riser = kind == RISER
    return _Fit(kind, np.where(is_riser, riser.value, tread.value), np.where(is_riser, riser.std, tread.std))


def _noise(strips: Strips, rotation: np.ndarray) -> float:
    """What a frame's depth scatters by about the faces that explain it best, in units of DEPTH_SIGMA_PER_M2."""
    tread, riser = explain_strips(strips, rotation, ROW_SAMPLES)
    enough = strips.ok.sum(axis=1) >= MIN_POINTS
    if not enough.any():
        return 1.0
    scatter = median(np.minimum(tread.scatter, riser.scatter)[enough])
    return min(max(scatter / MEDIAN_OF_NORMAL, 1.0), MAX_NOISE)


def explain_strips(strips: Strips, camera_to_stair: np.ndarray, rows: int) -> tuple[Candidate, Candidate]:
    """Every strip as a tread, and every strip as a riser.

    Args:
        strips: points whose consecutive `rows` lie in one image column, upper one first.
        camera_to_stair: (3, 3) rotation into (f, l, h).
        rows: samples per column.
    """

    from perception.geometry.strips import strip_kernels

    kernels: Any = strip_kernels
    answer = np.empty((2, len(strips.ok), 4))
    kernels.explain(*_points(strips, camera_to_stair), rows, answer)
    tread, riser = (Candidate(*part.T) for part in answer)
    return tread, riser


def _points(strips: Strips, rotation: np.ndarray) -> tuple[Any, ...]:
    """The arguments that the compiled loops share."""
    return (
        strips.rays,
        strips.depth_m,
        strips.ok,
        strips.points_per_reading,
        rotation,
        DEPTH_SIGMA_PER_M2 * strips.noise,
        DEPTH_FLOOR_M,
        ROBUST_CUT,
    )


def _solve_rotation(
    strips: Strips, fit: _Fit, rotation: np.ndarray, views: LineViews, turned: np.ndarray, gravity_std_rad: float
) -> tuple[np.ndarray, np.ndarray]:
    """One Gauss-Newton step (3,) of the rotation about (f, l, h) and its covariance (3, 3).

    Args:
        strips: the points.
        fit: the faces as they are now.
        rotation: (3, 3) camera to (f, l, h) as it is now.
        views: of the lines.
        turned: (3,) rotation since the first guess.
        gravity_std_rad: of the first guess about f and l.
    """
    normal, gradient = _equations(strips, fit.kind, fit.value, rotation, views)
    prior = np.array([1.0, 1.0, 0.0]) / gravity_std_rad**2
    normal += np.diag(prior + np.array([0.0, 0.0, 1.0 / math.radians(30.0) ** 2]))
    gradient += prior * turned
    cov = np.linalg.inv(normal)
    step = -cov @ gradient
    return np.clip(step, -0.1, 0.1), cov


def _free_odd_faces(normal: np.ndarray, gradient: np.ndarray, kind: np.ndarray) -> None:
    """Let faces that contradict the treads slope on their own: a floor that falls off, risers that lean. In place.

    Treads are built level, and alike. What they say of the pitch counts; a face that says something else has its own
    turn about l eliminated from its normal matrix (K, 3, 3) and gradient (K, 3), the more freely the more it differs.
    """
    known = normal[:, 1, 1]
    level = (kind == TREAD) & (known > 0.0)
    if level.sum() < MIN_TREADS_TO_COMPARE:
        return
    turn = gradient[:, 1] / np.maximum(known, 1e-9)
    doubt = np.hypot(FACE_SLOPE_STD_RAD, 1.0 / np.sqrt(np.maximum(known, 1e-9)))
    odd = np.abs(turn - _weighted_median(turn[level], 1.0 / doubt[level] ** 2)) / doubt
    own = FACE_SLOPE_STD_RAD * np.maximum(odd**2 - 1.0, 0.0)
    share = own**2 / (1.0 + known * own**2)
    column, pull = normal[:, :, 1].copy(), gradient[:, 1].copy()
    normal -= column[:, :, None] * column[:, None, :] * share[:, None, None]
    gradient -= column * (pull * share)[:, None]


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2.0)])


def _equations(
    strips: Strips,
    kind: np.ndarray,
    value: np.ndarray,
    rotation: np.ndarray,
    views: LineViews,
    line_gate_rad: float = LINE_GATE_RAD,
) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix (3, 3) and gradient (3,) of what faces and lines say about a small rotation about (f, l, h)."""
    from perception.geometry.strips import strip_kernels

    of_faces, pull = np.zeros((len(kind), 3, 3)), np.zeros((len(kind), 3))
    kernels: Any = strip_kernels
    kernels.normal_equations(*_points(strips, rotation), kind, value, of_faces, pull)
    _free_odd_faces(of_faces, pull, kind)
    normal, gradient = of_faces.sum(axis=0), pull.sum(axis=0)
    # The horizontal line in the plane with normal n runs along (n_l, -n_f, 0): its yaw error is n_l / n_f.
    n_f, n_l, n_h = rotation @ views.normals.T
    seen = np.abs(n_f) > 0.05  # a line at the horizon says nothing about yaw
    n_f, n_l, n_h, direction_std = n_f[seen], n_l[seen], n_h[seen], views.direction_std[seen]
    rows = np.stack([-n_h / n_f, np.zeros_like(n_f), np.ones_like(n_f)], axis=1)
    yaw_error = n_l / n_f
    sigma = np.hypot(direction_std / np.abs(n_f), 0.003)
    offset = np.abs(yaw_error - median(yaw_error)) if len(yaw_error) else yaw_error
    line_weight = np.where(offset < 4.0 * sigma + line_gate_rad, 1.0 / sigma**2, 0.0)
    normal += (rows * line_weight[:, None]).T @ rows
    gradient += rows.T @ (line_weight * yaw_error)
    return normal, gradient


def side_equations(
    strips: Strips,
    kind: np.ndarray,
    value: np.ndarray,
    camera_to_stair: np.ndarray,
    views: LineViews,
    line_gate_rad: float = LINE_GATE_RAD,
) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix (2, 2) and gradient (2,) of what faces and lines say about a small rotation about f and h alone.

    Args:
        strips: K sampled strips.
        kind, value: (K,) what they show and where.
        camera_to_stair: (3, 3) rotation into (f, l, h).
        views: of the lines.
        line_gate_rad: how far a line's direction may be from the others'.
    """
    normal, gradient = _equations(strips, kind, value, camera_to_stair, views, line_gate_rad)
    sideways = [0, 2]
    normal = normal[np.ix_(sideways, sideways)] + np.diag([0.0, 1.0 / math.radians(30.0) ** 2])
    return normal, gradient[sideways]


def _small_rotation(angles: np.ndarray) -> np.ndarray:
    """(3, 3) rotation matrix of a rotation vector (3,), radians (Rodrigues)."""
    angle = float(np.linalg.norm(angles))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = angles / angle
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * skew + (1.0 - math.cos(angle)) * (skew @ skew)
