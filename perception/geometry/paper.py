"""Equations 7 to 9 of the paper to the letter: the method that `perception.geometry.planes` is measured against.

Nine sampling points per line, symmetric about the image's middle axis, their depth as it is, a least-squares line in
space with x and y as functions of z, its intersection with the camera's YOZ plane, roll and pitch by equation 8, yaw
as the mean over pairs of sampling points, and widths and heights between neighbouring lines. When the camera faces the
stairs squarely z hardly changes along a line and the fit is ill-conditioned; nothing is done about it here.
"""

from __future__ import annotations

import math

import numpy as np

from perception.geometry.cross_section import DOWN, UP
from perception.geometry.planes import MIN_SUPPORT, OMEGA_M, Geometry, attitude_angles
from perception.geometry.results import Nosing, StepMeasurement
from stair_env.intrinsics import Intrinsics

SAMPLES_PER_SIDE = 4
MIN_READINGS = 3  # sampling points with depth, for a line to be fitted


def measure_stairs_as_the_paper(
    lines: np.ndarray, depth_m: np.ndarray, intrinsics: Intrinsics, gravity: np.ndarray, *, omega_m: float = OMEGA_M
) -> Geometry:
    """Width and height of the steps as the paper computes them.

    Args:
        lines: (m, 8) rows of `perception.geometry.lines.LINE_FIELDS`, pixels of the depth image, any order.
        depth_m: (H, W) float, metres, 0 = no reading.
        intrinsics: of the depth image.
        gravity: (3,) accelerometer reading at rest, camera frame.
        omega_m: smaller values of equation 9 are discarded, metres.

    Returns:
        Geometry; the paper states no errors, so that standard deviations are 0.
    """
    unknown = ("unknown",) * len(lines)
    pitch, roll = attitude_angles(gravity)
    to_world = _rotation(pitch, roll)
    crossings, yaws = [], []
    for row in sorted(lines, key=lambda line: -(line[1] + line[3])):  # nearest, lowest in the image, first
        points = _sample_line(row, depth_m, intrinsics) if row[7] >= MIN_SUPPORT else np.empty((0, 3))
        crossing = _crossing_with_yoz(points)
        if crossing is None:
            continue
        crossings.append(to_world @ crossing)
        yaws.append(_yaw(points @ to_world.T))
    if len(crossings) < 2:
        return Geometry(kinds=unknown, reason="fewer than two lines with depth")
    yaw = float(np.mean(yaws))
    along = np.array([[point[2] * math.cos(yaw), -point[1]] for point in crossings])  # (m, 2) forward, up; x is 0
    return _steps_from_section(along, yaw, unknown, omega_m)


def _rotation(pitch: float, roll: float) -> np.ndarray:
    """(3, 3) camera to world (x right, y down, z forward level) from the attitude angles."""
    cp, sp, cr, sr = math.cos(pitch), math.sin(pitch), math.cos(roll), math.sin(roll)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cp, -sp], [0.0, sp, cp]])
    about_z = np.array([[cr, -sr, 0.0], [sr, cr, 0.0], [0.0, 0.0, 1.0]])
    return about_x @ about_z


def _sample_line(row: np.ndarray, depth_m: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """(n <= 9, 3) points in the camera frame: the middle axis and four on each side, as far as the line reaches."""
    x1, x2, k, b = row[0], row[2], row[4], row[5]
    middle = intrinsics.width / 2.0
    reach = min(middle - x1, x2 - middle)
    if reach > 0.0:
        x = middle + reach * np.arange(-SAMPLES_PER_SIDE, SAMPLES_PER_SIDE + 1) / SAMPLES_PER_SIDE
    else:  # the line lies on one side of the axis
        x = np.linspace(x1, x2, 2 * SAMPLES_PER_SIDE + 1)
    y = k * x + b
    rows, columns = depth_m.shape
    u, v = np.clip(x.astype(int), 0, columns - 1), np.clip(np.floor(y).astype(int), 0, rows - 1)
    z = depth_m[v, u].astype(np.float64)
    points = intrinsics.deproject(np.stack([x, y], axis=1), z)
    return points[z > 0.0]


def _crossing_with_yoz(points: np.ndarray) -> np.ndarray | None:
    """Equation 7: x = k1 z + b1, y = k2 z + b2 by least squares, at x = 0; None when it cannot be solved."""
    if len(points) < MIN_READINGS or np.ptp(points[:, 2]) == 0.0:
        return None
    k1, b1 = np.polyfit(points[:, 2], points[:, 0], 1)
    k2, b2 = np.polyfit(points[:, 2], points[:, 1], 1)
    if abs(k1) < 1e-6:
        return None
    crossing = np.array([0.0, (k1 * b2 - k2 * b1) / k1, -b1 / k1])
    return crossing if np.isfinite(crossing).all() and 0.0 < crossing[2] < 20.0 else None


def _yaw(points_world: np.ndarray) -> float:
    """Mean yaw over pairs of sampling points, radians, positive when the camera looks to the right."""
    first, second = points_world[: len(points_world) // 2], points_world[-(len(points_world) // 2) :]
    dx, dz = second[:, 0] - first[:, 0], second[:, 2] - first[:, 2]
    return float(np.mean(np.arctan2(dz, np.maximum(dx, 1e-9))))


def _steps_from_section(along: np.ndarray, yaw: float, kinds: tuple[str, ...], omega_m: float) -> Geometry:
    """Equation 9 over (m, 2) points of the cross-section (forward, up), nearest first."""
    delta = np.diff(along, axis=0)
    has_width, has_height = np.abs(delta[:, 0]) >= omega_m, np.abs(delta[:, 1]) >= omega_m
    rises = delta[has_height, 1]
    direction = int(np.sign(rises.sum())) if len(rises) else 0
    if direction == 0:
        return Geometry(kinds=kinds, yaw_rad=yaw, reason="no height differences between the lines")
    steps = _ascending(along, delta, has_width, has_height) if direction == UP else _descending(along, delta, omega_m)
    nosings = tuple(Nosing(s.distance_m, 0.0, h, 0.0, s.height_m, 0.0, s.width_m, 0.0) for s, h in steps)
    reason = "" if nosings else "no complete step in view"
    return Geometry(direction, nosings, tuple(s for s, _ in steps), yaw, 0.0, kinds, reason)


def _ascending(
    along: np.ndarray, delta: np.ndarray, has_width: np.ndarray, has_height: np.ndarray
) -> list[tuple[StepMeasurement, float]]:
    """A height between an inner edge and a nosing, then a width between the nosing and the next inner edge."""
    steps = []
    for i in range(len(delta)):
        width, height, forward, top = abs(delta[i, 0]), abs(delta[i, 1]), along[i, 0], along[i, 1]
        if not has_height[i]:
            continue
        if not has_width[i]:  # from an inner edge up to a nosing; the tread follows
            if i + 1 == len(delta) or not has_width[i + 1] or has_height[i + 1]:
                continue
            width, forward, top = abs(delta[i + 1, 0]), along[i + 1, 0], along[i + 1, 1]
        steps.append((StepMeasurement(float(width), float(height), 0.0, 0.0, float(forward)), float(top)))
    return steps


def _descending(along: np.ndarray, delta: np.ndarray, omega_m: float) -> list[tuple[StepMeasurement, float]]:
    """Width and height between neighbouring nosings."""
    return [
        (StepMeasurement(abs(d[0]), abs(d[1]), 0.0, 0.0, float(point[0])), float(point[1]))
        for point, d in zip(along, delta)
        if abs(d[0]) >= omega_m and DOWN * d[1] >= omega_m
    ]
