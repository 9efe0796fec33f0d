"""What every renderer takes and gives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from stair_env.intrinsics import Intrinsics
from stair_env.scene.shapes import Shape
from stair_env.stairs import StairEdge

NEAR_M = 0.01  # nothing closer to the camera is drawn
FAR_M = 60.0  # nothing farther is; a D435i reports nothing beyond about 10 m


@dataclass(frozen=True)
class Frame:
    """What an ideal RGB-D camera sees.

    Attributes:
        rgb: uint8 (H, W, 3), sRGB.
        depth_m: float32 (H, W), distance along the optical axis, metres; 0 where nothing was hit.
        segmentation: int32 (H, W), index into the scene's shapes, then into the moving ones; -1 where nothing was hit.
    """

    rgb: np.ndarray
    depth_m: np.ndarray
    segmentation: np.ndarray


class SceneLike(Protocol):
    """The part of `stair_env.sampling.Scene` that a renderer reads."""

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Static solids in the world frame."""

    @property
    def edges(self) -> tuple[StairEdge, ...]:
        """Stair lines in the world frame."""


class Renderer(Protocol):
    """Draws one scene from any viewpoint."""

    def render(self, intrinsics: Intrinsics, camera_to_world: np.ndarray, *, moving: Sequence[Shape] = ()) -> Frame:
        """Draw a frame.

        Args:
            intrinsics: of the image to draw.
            camera_to_world: (4, 4) pose of the optical frame (x right, y down, z forward).
            moving: solids in the world frame besides the scene's own, such as a robot's links.
        """

    def close(self) -> None:
        """Release what the renderer holds; calling it twice is fine."""


def check_pose(camera_to_world: np.ndarray) -> np.ndarray:
    """Return the pose as a (4, 4) float64 array.

    Raises:
        ValueError: it is not a finite rigid transform.
    """
    pose = np.asarray(camera_to_world, dtype=np.float64)
    if pose.shape != (4, 4):
        raise ValueError(f"camera_to_world has shape {pose.shape}, must be (4, 4)")
    rows = pose.tolist()  # between two frames arrays find cold caches: plain numbers take a tenth of the time here
    x, y, z = (row[:3] for row in rows[:3])
    lengths, slants = (_dot(x, x), _dot(y, y), _dot(z, z)), (_dot(x, y), _dot(y, z), _dot(z, x))
    # Written so that NaN fails too.
    orthonormal = all(abs(length - 1.0) < 1e-6 for length in lengths) and all(abs(slant) < 1e-6 for slant in slants)
    if not (orthonormal and all(math.isfinite(row[3]) for row in rows)):
        raise ValueError("camera_to_world must be a finite rigid transform")
    cross = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]
    if _dot(cross, z) < 0.0 or rows[3] != [0.0, 0.0, 0.0, 1.0]:
        raise ValueError("camera_to_world must be a rotation and a translation, last row (0, 0, 0, 1)")
    return pose


def _dot(a: list[float], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
