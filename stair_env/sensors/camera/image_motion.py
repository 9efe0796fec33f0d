"""How far the picture moves between two poses of the camera."""

from __future__ import annotations

import math

import numpy as np

from stair_env.intrinsics import Intrinsics


def middle_distance_m(depth_m: np.ndarray, near_m: float, far_m: float) -> float:
    """Median of the depths (H, W) float32 within near_m..far_m, by every 16th pixel; far_m if there is none."""
    sample = depth_m[::16, ::16].ravel()
    sample = sample[(sample >= np.float32(near_m)) & (sample <= np.float32(far_m)) & (sample > 0.0)]
    if len(sample) == 0:
        return far_m
    sample.sort()  # np.median takes four times as long to say the same
    return float(np.float32(0.5) * (sample[(len(sample) - 1) // 2] + sample[len(sample) // 2]))


def motion_between(before: np.ndarray, after: np.ndarray) -> tuple[float, float]:
    """By what angle (radians) and how far (metres) a camera has moved between two poses (4, 4).

    In plain numbers: between two frames numpy's small functions and scipy's rotations find cold caches and take a
    quarter of a millisecond.
    """
    a, b = before.tolist(), after.tolist()
    r = [[sum(a[k][i] * b[k][j] for k in range(3)) for j in range(3)] for i in range(3)]
    sine = 0.5 * math.hypot(r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1])
    cosine = 0.5 * (r[0][0] + r[1][1] + r[2][2] - 1.0)
    return math.atan2(sine, cosine), math.hypot(*(b[i][3] - a[i][3] for i in range(3)))


def image_motion_px(
    intrinsics: Intrinsics, previous_to_world: np.ndarray, camera_to_world: np.ndarray, distance_m: float
) -> np.ndarray:
    """How far what is in the middle of the image has moved since the previous pose.

    Args:
        intrinsics: of the image.
        previous_to_world, camera_to_world: (4, 4) camera poses then and now.
        distance_m: of the thing in the middle of the image now, metres.

    Returns:
        (2,) float64 (right, down), pixels; zeros when it was behind the previous camera.
    """
    point = camera_to_world[:3, 3] + distance_m * camera_to_world[:3, 2]
    before = previous_to_world[:3, :3].T @ (point - previous_to_world[:3, 3])
    if before[2] <= 1e-3:
        return np.zeros(2)
    return -np.array([intrinsics.fx * before[0], intrinsics.fy * before[1]]) / before[2]
