"""What depth says about the way the camera hangs, where gravity is in doubt.

Pitch follows from how treads and risers are seen one above the other (`perception.geometry.rounded`). Roll and yaw
follow from how depth and lines run sideways, which rounded creases do not change.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from perception.geometry.strips.strip_labels import RISER
from perception.geometry.strips.strip_planes import (
    LINE_GATE_RAD,
    ROW_SAMPLES,
    LineViews,
    Strips,
    explain_strips,
    side_equations,
)

ROUNDS = 4
FIRST_GATE_RAD = 0.15  # six degrees of roll turn the lines' directions apart by as much
MAX_STEP_RAD = 0.1
SETTLED_RAD = 0.001


def turn_pitch(turn_rad: float) -> np.ndarray:
    """(3, 3) rotation of (f, l, h) coordinates under which everything is seen steeper by an angle."""
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    return np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])


def turn_sideways(roll_rad: float, yaw_rad: float) -> np.ndarray:
    """(3, 3) rotation by small angles about f and h."""
    angle = math.hypot(roll_rad, yaw_rad)
    if angle < 1e-12:
        return np.eye(3)
    x, z = roll_rad / angle, yaw_rad / angle
    skew = np.array([[0.0, -z, 0.0], [z, 0.0, -x], [0.0, x, 0.0]])
    return np.eye(3) + math.sin(angle) * skew + (1.0 - math.cos(angle)) * (skew @ skew)


def level_sideways(
    strips: Strips, kind: np.ndarray, camera_to_stair: np.ndarray, views: LineViews, roll_std_rad: float
) -> tuple[np.ndarray, np.ndarray]:
    """Correct roll and yaw by how the faces and the lines run sideways.

    Args:
        strips: K sampled strips.
        kind: (K,) what they show.
        camera_to_stair: (3, 3) rotation into (f, l, h), pitch corrected already.
        views: of the lines.
        roll_std_rad: of gravity's roll; with long tails, as it may be wrong by anything.

    Returns:
        (3, 3) corrected rotation, and (2, 2) covariance of what is left about f and h, rad^2.
    """
    rotation, rolled = camera_to_stair, 0.0
    covariance = np.diag([roll_std_rad**2, 0.1**2])
    for turn in range(ROUNDS):
        tread, riser = explain_strips(strips, rotation, ROW_SAMPLES)
        value = np.where(kind == RISER, riser.value, tread.value)
        normal, gradient = side_equations(
            strips, kind, value, rotation, views, LINE_GATE_RAD if turn else FIRST_GATE_RAD
        )
        prior = 2.0 / (roll_std_rad**2 + rolled**2)
        normal[0, 0] += prior
        gradient[0] += prior * rolled
        covariance = np.linalg.inv(normal)
        step: Any = np.clip(-covariance @ gradient, -MAX_STEP_RAD, MAX_STEP_RAD)
        rotation = turn_sideways(float(step[0]), float(step[1])) @ rotation
        rolled += float(step[0])
        if np.abs(step).max() < SETTLED_RAD:
            break
    return rotation, covariance


def in_section(forward_m: np.ndarray, height_m: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forward distances and heights after a rotation (3, 3) of (f, l, h), as far as it is about l."""
    return (
        turn[0, 0] * forward_m + turn[0, 2] * height_m,
        turn[2, 0] * forward_m + turn[2, 2] * height_m,
    )
