"""Stairs from the point cloud alone: horizontal planes by height, no colour and no network (a row of table 7).

The usual way before lines were learned: points whose surroundings are level grow into planes of one height; what rises
from one to the next is the riser, what lies between their front edges the tread. Heights need gravity, the walking
direction comes from the risers' normals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from perception.geometry.planes import camera_to_level
from perception.geometry.results import StairEstimate, StepMeasurement
from stair_env.common.validation import check_range
from stair_env.intrinsics import Intrinsics

STRIDE_PX = 4  # of the points that are looked at
REACH = 2  # points on either side that a normal is made of
MAX_STEP_SHARE = 0.05  # of the distance, between these points: more is an edge between two things
LEVEL, UPRIGHT = math.cos(math.radians(20.0)), math.sin(math.radians(25.0))  # |vertical part| of a normal: more, less
BIN_M, SMOOTH_M = 0.005, 0.012  # of the histogram of heights
LEAST_APART_M = 0.06  # two planes
INLIER_M = 0.02  # from a plane's height
EDGE_PERCENT = 3.0  # of a plane's points that lie before its front edge
LEAST_RISERS = 40  # points on risers, to tell the walking direction
MAX_YAW_RAD = math.radians(60.0)
RISERS_M, TREADS_M = (0.04, 0.30), (0.12, 0.60)


@dataclass(frozen=True)
class PointPlanesConfig:
    """What counts.

    Args:
        max_distance_m: of points; stereo depth says nothing of a riser farther away.
        least_area_m2: of a plane.

    Raises:
        SpecError: a value is out of range (a ValueError).
    """

    max_distance_m: float = 3.5
    least_area_m2: float = 0.02

    def __post_init__(self) -> None:
        check_range("max_distance_m", self.max_distance_m, 0.3, 20.0)
        check_range("least_area_m2", self.least_area_m2, 0.0, 10.0)


@dataclass(frozen=True)
class _Plane:
    """A level plane: height above the camera, and from where to where it reaches ahead, metres."""

    height: float
    front: float
    back: float


def measure_point_planes(
    depth_m: np.ndarray, intrinsics: Intrinsics, gravity: np.ndarray, config: PointPlanesConfig | None = None
) -> StairEstimate:
    """Steps between the level planes of a point cloud.

    Args:
        depth_m: (H, W) float, metres, 0 = no reading.
        intrinsics: of that image.
        gravity: (3,) accelerometer reading at rest, camera frame, m/s^2.
        config: what counts.

    Returns:
        StairEstimate without lines; not valid, with a reason, where no two planes make a step.
    """
    config = config or PointPlanesConfig()
    points, normals = _oriented_points(depth_m, intrinsics, gravity, config.max_distance_m)
    vertical = np.abs(normals[:, 1])
    yaw = _heading(normals[vertical < UPRIGHT])
    ahead = points[:, 0] * math.sin(-yaw) + points[:, 2] * math.cos(yaw)
    level = vertical > LEVEL
    # A point stands for the area that its pixels see, whatever the distance.
    area = (points[:, 2] * STRIDE_PX) ** 2 / (intrinsics.fx * intrinsics.fy) / np.maximum(vertical, LEVEL)
    planes = _planes(-points[level, 1], ahead[level], area[level], config.least_area_m2)
    if len(planes) < 2:
        return StairEstimate(False, reason="fewer than two level planes")
    heights, places = (np.array(values) for values in zip(*((p.height, p.front + p.back) for p in planes)))
    direction = 1 if np.sum((heights - heights.mean()) * (places - places.mean())) > 0.0 else -1
    steps = tuple(_steps(planes[::direction], direction))
    if not steps:
        return StairEstimate(False, reason="no two neighbouring planes make a step")
    return StairEstimate(True, direction, steps=steps, yaw_rad=yaw, next_edge_m=steps[0].distance_m)


def _oriented_points(
    depth_m: np.ndarray, intrinsics: Intrinsics, gravity: np.ndarray, max_distance_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) points and unit normals in the level frame (right, down, forward)."""
    half = STRIDE_PX // 2
    depth = np.asarray(depth_m[half::STRIDE_PX, half::STRIDE_PX], dtype=np.float64)
    rows, columns = np.mgrid[half : depth_m.shape[0] : STRIDE_PX, half : depth_m.shape[1] : STRIDE_PX]
    x = (columns + 0.5 - intrinsics.cx) / intrinsics.fx * depth
    y = (rows + 0.5 - intrinsics.cy) / intrinsics.fy * depth
    grid = np.stack([x, y, depth], axis=-1) @ camera_to_level(gravity).T
    middle = (slice(REACH, -REACH), slice(REACH, -REACH))
    across = grid[REACH:-REACH, 2 * REACH :] - grid[REACH:-REACH, : -2 * REACH]
    along = grid[2 * REACH :, REACH:-REACH] - grid[: -2 * REACH, REACH:-REACH]
    ends = np.stack(
        [
            depth[REACH:-REACH, 2 * REACH :],
            depth[REACH:-REACH, : -2 * REACH],
            depth[2 * REACH :, REACH:-REACH],
            depth[: -2 * REACH, REACH:-REACH],
            depth[middle],
        ]
    )
    nearest, farthest = ends.min(axis=0), ends.max(axis=0)
    whole = (nearest > 0.0) & (farthest < max_distance_m) & (farthest - nearest < 4 * REACH * MAX_STEP_SHARE * farthest)
    normals = np.cross(across[whole], along[whole])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return grid[middle][whole], normals / np.maximum(length, 1e-12)


def _heading(normals: np.ndarray) -> float:
    """Yaw of the camera to the stairs, radians, positive when it looks to the right of their walking direction."""
    facing = np.where(normals[:, 2:] > 0.0, -normals, normals)
    yaw = np.arctan2(facing[:, 0], -facing[:, 2])
    yaw = yaw[np.abs(yaw) < MAX_YAW_RAD]
    return float(np.median(yaw)) if len(yaw) >= LEAST_RISERS else 0.0


def _planes(height: np.ndarray, ahead: np.ndarray, area: np.ndarray, least_area_m2: float) -> list[_Plane]:
    """Heights at which much of the area lies, lowest first."""
    if len(height) == 0:
        return []
    edges = np.arange(height.min() - 0.1, height.max() + 0.1 + BIN_M, BIN_M)
    density = gaussian_filter1d(np.histogram(height, edges, weights=area)[0], SMOOTH_M / BIN_M)
    peaks, _ = find_peaks(density, distance=max(round(LEAST_APART_M / BIN_M), 1))
    planes = []
    for peak in peaks:
        near = np.abs(height - (edges[peak] + BIN_M / 2.0)) < INLIER_M
        if area[near].sum() < least_area_m2:
            continue
        front, back = np.percentile(ahead[near], (EDGE_PERCENT, 100.0 - EDGE_PERCENT))
        planes.append(_Plane(float(np.median(height[near])), float(front), float(back)))
    return planes


def _steps(planes: list[_Plane], direction: int) -> list[StepMeasurement]:
    """Riser and tread at every nosing that has both."""
    edges = [plane.front for plane in planes[1:]] if direction > 0 else [plane.back for plane in planes]
    rises = direction * np.diff([plane.height for plane in planes])
    steps = []
    for edge, following, rise in zip(edges, edges[1:], rises):
        width = following - edge
        if RISERS_M[0] < rise < RISERS_M[1] and TREADS_M[0] < width < TREADS_M[1]:
            steps.append(StepMeasurement(width, float(rise), 0.0, 0.0, edge))
    return steps
