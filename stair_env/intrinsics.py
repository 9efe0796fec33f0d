"""Pinhole model of a camera, and the colour modes of the RealSense D435i.

The camera frame is optical: x right, y down, z forward. Image coordinates (u, v) are continuous and in pixels; the
top left corner of the image is (0, 0), so that the centre of the first pixel is (0.5, 0.5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stair_env.common.validation import JsonSpec, SpecError, check_range

MAX_IMAGE_SIDE_PX = 8192
MAX_FIELD_OF_VIEW_RAD = math.radians(170.0)


@dataclass(frozen=True)
class Intrinsics(JsonSpec):
    """Pinhole intrinsics, validated, JSON-able through `to_dict`.

    Args:
        width, height: image size, pixels.
        fx, fy: focal lengths, pixels.
        cx, cy: principal point, pixels from the top left corner of the image.

    Raises:
        SpecError: a field is out of range (a ValueError).
    """

    ARGUMENT = "intrinsics"

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
                raise SpecError(f"{name}={value!r} must be a whole number of pixels")
            check_range(name, int(value), 1, MAX_IMAGE_SIDE_PX)
            object.__setattr__(self, name, int(value))
        for name, side in (("fx", self.width), ("fy", self.height)):
            low = side / 2.0 / math.tan(MAX_FIELD_OF_VIEW_RAD / 2.0)
            check_range(name, getattr(self, name), low, 1000.0 * side)
        for name in ("cx", "cy"):  # outside the image when it is a crop
            check_range(name, getattr(self, name), -MAX_IMAGE_SIDE_PX, MAX_IMAGE_SIDE_PX)
        for name in ("fx", "fy", "cx", "cy"):
            object.__setattr__(self, name, float(getattr(self, name)))

    @classmethod
    def from_fov(cls, width: int, height: int, vertical_fov_rad: float) -> Intrinsics:
        """Square pixels, principal point in the middle.

        Args:
            width, height: image size, pixels.
            vertical_fov_rad: angle between the top and the bottom edge of the image, radians.

        Raises:
            SpecError: the angle or the size is out of range.
        """
        check_range("vertical_fov_rad", vertical_fov_rad, 1e-3, MAX_FIELD_OF_VIEW_RAD)
        focal_px = height / 2.0 / math.tan(vertical_fov_rad / 2.0)
        return cls(width, height, focal_px, focal_px, width / 2.0, height / 2.0)

    @property
    def horizontal_fov_rad(self) -> float:
        """Angle between the left and the right edge of the image, radians."""
        return math.atan(self.cx / self.fx) + math.atan((self.width - self.cx) / self.fx)

    @property
    def vertical_fov_rad(self) -> float:
        """Angle between the top and the bottom edge of the image, radians."""
        return math.atan(self.cy / self.fy) + math.atan((self.height - self.cy) / self.fy)

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) float64 camera matrix K: K @ (x, y, z) = z (u, v, 1)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points_camera: np.ndarray) -> np.ndarray:
        """Image coordinates of points in the camera frame.

        Args:
            points_camera: (..., 3) metres; points with z <= 0 have no image and become NaN.

        Returns:
            (..., 2) float64 (u, v), pixels.
        """
        points = np.asarray(points_camera, dtype=np.float64)
        z = np.where(points[..., 2] > 0.0, points[..., 2], np.nan)
        u = self.fx * points[..., 0] / z + self.cx
        v = self.fy * points[..., 1] / z + self.cy
        return np.stack([u, v], axis=-1)

    def deproject(self, uv: np.ndarray, depth_m: np.ndarray | float) -> np.ndarray:
        """Points in the camera frame, the inverse of `project`.

        Args:
            uv: (..., 2) pixels.
            depth_m: (...) distance along the optical axis, metres.

        Returns:
            (..., 3) float64, metres.
        """
        uv = np.asarray(uv, dtype=np.float64)
        depth = np.asarray(depth_m, dtype=np.float64)
        x = (uv[..., 0] - self.cx) / self.fx * depth
        y = (uv[..., 1] - self.cy) / self.fy * depth
        return np.stack([x, y, np.broadcast_to(depth, x.shape)], axis=-1)

    def rays(self) -> np.ndarray:
        """(height, width, 3) float64 directions through the pixel centres in the camera frame, z = 1."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return self.deproject(np.stack([u, v], axis=-1), 1.0)

    def scaled(self, width: int, height: int) -> Intrinsics:
        """Intrinsics of the same view resampled to another size."""
        sx, sy = width / self.width, height / self.height
        return Intrinsics(width, height, self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy)

    def letterboxed(self, size: int = 512) -> Intrinsics:
        """Intrinsics of the image padded around the centre to a square and scaled to size x size pixels."""
        left, top, side = letterbox_padding(self.width, self.height)
        s = size / side
        return Intrinsics(size, size, self.fx * s, self.fy * s, (self.cx + left) * s, (self.cy + top) * s)


def letterbox_padding(width: int, height: int) -> tuple[int, int, int]:
    """Whole pixels padded at the left and at the top, and the side of the square, for a width x height image."""
    side = max(width, height)
    return (side - width) // 2, (side - height) // 2, side


def _d435i_colour(width: int, height: int) -> Intrinsics:
    # The 69 x 42 degrees of the data sheet are those of the 16:9 sensor, and 4:3 modes crop its sides, so the focal
    # length follows the image height; 615 px at 480 rows gives 69.5 x 42.6 degrees at 1280x720.
    focal_px = 615.0 * height / 480.0
    return Intrinsics(width, height, focal_px, focal_px, width / 2.0, height / 2.0)


D435I_COLOR_MODES: dict[str, Intrinsics] = {
    "640x480": _d435i_colour(640, 480),
    "848x480": _d435i_colour(848, 480),
    "1280x720": _d435i_colour(1280, 720),
}

D435I_COLOUR_OFFSET_M = 0.015  # colour imager left of the left infrared imager (data sheet; read from devices)


def _d435i_depth(width: int, height: int, focal_px: float) -> Intrinsics:
    return Intrinsics(width, height, focal_px, focal_px, width / 2.0, height / 2.0)


# The data sheet's 87 degrees over 848 and 1280 pixels; 640x480 is narrower.
D435I_DEPTH_MODES: dict[str, Intrinsics] = {
    "640x480": _d435i_depth(640, 480, 382.0),
    "848x480": _d435i_depth(848, 480, 447.0),
    "1280x720": _d435i_depth(1280, 720, 674.0),
}
