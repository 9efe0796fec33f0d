"""Poses of cameras as (4, 4) transforms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# Columns are the camera's x (right), y (down) and z (forward) in a body frame of x forward, y left, z up.
_BODY_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def look_along(position: np.ndarray, yaw_rad: float, pitch_down_rad: float, roll_rad: float = 0.0) -> np.ndarray:
    """camera_to_world of a camera at position.

    Args:
        position: (3,) metres, world frame.
        yaw_rad: heading of the optical axis from +x towards +y.
        pitch_down_rad: tilt of the optical axis below the horizon.
        roll_rad: turn about the optical axis, clockwise as the camera sees itself turn.

    Returns:
        (4, 4) float64.
    """
    from scipy.spatial.transform import Rotation  # 0.1 s that a worker without a camera does not need

    body = Rotation.from_euler("ZYX", [yaw_rad, pitch_down_rad, roll_rad]).as_matrix()
    transform = np.eye(4)
    transform[:3, :3] = body @ _BODY_FROM_CAMERA
    transform[:3, 3] = position
    return transform


def look_at(eye: Sequence[float], target: Sequence[float], roll_rad: float = 0.0) -> np.ndarray:
    """Camera pose that looks from one point at another.

    Args:
        eye: (3,) position of the camera, world frame, metres.
        target: (3,) point in the middle of the image, not straight above or below the eye.
        roll_rad: rotation about the optical axis; positive turns the camera clockwise as seen from behind it.

    Returns:
        (4, 4) float64 camera_to_world.

    Raises:
        ValueError: the direction is vertical or of no length.
    """
    forward = np.asarray(target, dtype=np.float64) - np.asarray(eye, dtype=np.float64)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-9 * max(1.0, float(np.linalg.norm(forward))):
        raise ValueError(f"target={tuple(target)} must not lie straight above or below eye={tuple(eye)}")
    forward /= np.linalg.norm(forward)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cos, sin = np.cos(roll_rad), np.sin(roll_rad)
    pose = np.eye(4)
    pose[:3, 0] = cos * right + sin * down
    pose[:3, 1] = cos * down - sin * right
    pose[:3, 2] = forward
    pose[:3, 3] = eye
    return pose
