"""Cameras with distortion: what calibration files and recordings say, and images as a pinhole would have seen them.

The package counts pixels from the image's corner, so that the first pixel's centre is (0.5, 0.5). librealsense, ROS and
OpenCV put (0, 0) there: half a pixel is added to principal points that come from them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from stair_env.common.field_kinds import naming_fields
from stair_env.common.validation import SpecError, check_choice
from stair_env.intrinsics import Intrinsics

HALF_PIXEL = 0.5
# "brown" and "rational" (OpenCV's k1 k2 p1 p2 k3 [k4 k5 k6]) and "fisheye" (k1..k4 of the angle) bend the true ray into
# the image. "inverse_brown" is the same polynomial the other way: it makes the true ray out of the image's.
COEFFICIENTS: dict[str, tuple[int, ...]] = {
    "none": (0,),
    "brown": (4, 5),
    "rational": (8,),
    "fisheye": (4,),
    "inverse_brown": (5,),
}
DISTORTIONS = tuple(COEFFICIENTS)
INVERSION_STEPS = 20  # fixed-point steps; a D435i's lens needs three


@dataclass(frozen=True)
class Lens:
    """A pinhole and what its lens does to it.

    Args:
        intrinsics: pinhole part.
        distortion: one of DISTORTIONS.
        coefficients: as many as the distortion has.

    Raises:
        SpecError: no such distortion, or a wrong number of coefficients (a ValueError).
    """

    intrinsics: Intrinsics
    distortion: str = "none"
    coefficients: tuple[float, ...] = field(default=())

    @naming_fields
    def __post_init__(self) -> None:
        check_choice("distortion", self.distortion, DISTORTIONS)
        values = tuple(float(value) for value in self.coefficients)
        object.__setattr__(self, "coefficients", values)
        if len(values) not in COEFFICIENTS[self.distortion] or not np.isfinite(values).all():
            counts = " or ".join(map(str, COEFFICIENTS[self.distortion]))
            raise SpecError(
                f"coefficients={values!r} of distortion {self.distortion!r} must be {counts} finite numbers"
            )

    @property
    def is_pinhole(self) -> bool:
        """Whether the image is a pinhole's already."""
        return self.distortion == "none" or (self.distortion != "fisheye" and not any(self.coefficients))

    def scaled(self, width: int, height: int) -> Lens:
        """The same lens over an image resampled to another size."""
        return Lens(self.intrinsics.scaled(width, height), self.distortion, self.coefficients)

    def bent(self, rays: np.ndarray) -> np.ndarray:
        """Where rays meet the image.

        Args:
            rays: (n, 2) x/z, y/z of the true rays.

        Returns:
            (n, 2) float64 x, y on the image at focal length 1.
        """
        rays = np.asarray(rays, np.float64)
        if self.is_pinhole:
            return rays
        if self.distortion == "inverse_brown":
            bent = rays.copy()
            for _ in range(INVERSION_STEPS):
                bent += rays - _brown(bent, self.coefficients)
            return bent
        points = np.column_stack([rays, np.ones(len(rays))])[:, None]
        zero, eye, values = np.zeros(3), np.eye(3), np.array(self.coefficients)
        if self.distortion == "fisheye":
            image, _ = cv2.fisheye.projectPoints(points, zero, zero, eye, values)
        else:
            image, _ = cv2.projectPoints(points, zero, zero, eye, values)
        return np.asarray(image).reshape(-1, 2)


def _brown(points: np.ndarray, coefficients: Sequence[float]) -> np.ndarray:
    """(n, 2) through the polynomial k1 k2 p1 p2 k3."""
    k1, k2, p1, p2, k3 = coefficients
    x, y = points[:, 0], points[:, 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.column_stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)]
    )


class Rectifier:
    """Makes a pinhole's images of a lens's; intrinsics stay, corners that the lens did not see are black.

    Args:
        lens: of the images.
    """

    def __init__(self, lens: Lens) -> None:
        self.lens = lens
        self._maps: tuple[np.ndarray, np.ndarray] | None = None
        if not lens.is_pinhole:
            model = lens.intrinsics
            bent = lens.bent(model.rays().reshape(-1, 3)[:, :2]).reshape(model.height, model.width, 2)
            u, v = model.fx * bent[..., 0] + model.cx, model.fy * bent[..., 1] + model.cy
            self._maps = (u - HALF_PIXEL).astype(np.float32), (v - HALF_PIXEL).astype(np.float32)

    def colour(self, rgb: np.ndarray) -> np.ndarray:
        """uint8 (H, W, 3) of the pinhole."""
        return rgb if self._maps is None else np.asarray(cv2.remap(rgb, *self._maps, cv2.INTER_LINEAR))

    def depth(self, depth_m: np.ndarray) -> np.ndarray:
        """float32 (H, W) of the pinhole; readings are moved, never mixed."""
        return depth_m if self._maps is None else np.asarray(cv2.remap(depth_m, *self._maps, cv2.INTER_NEAREST))


def ros_lens(width: int, height: int, k: Sequence[float], model: str, d: Sequence[float]) -> Lens:
    """Lens of a ROS `camera_info`.

    Args:
        width, height: of the images.
        k: (9,) row by row.
        model: "plumb_bob", "rational_polynomial", "equidistant" or "" (none).
        d: coefficients.

    Raises:
        SpecError: a model that is not known, or numbers that do not fit.
    """
    names = {"plumb_bob": "brown", "rational_polynomial": "rational", "equidistant": "fisheye", "": "none"}
    check_choice("distortion_model", model, tuple(names))
    if len(k) != 9:
        raise SpecError(f"camera matrix has {len(k)} numbers, must be 9")
    intrinsics = Intrinsics(int(width), int(height), k[0], k[4], k[2] + HALF_PIXEL, k[5] + HALF_PIXEL)
    values = [float(value) for value in d]
    name = names[model] if any(values) or model == "equidistant" else "none"
    return Lens(intrinsics, name, tuple(values) if name != "none" else ())


def realsense_lens(values: Any) -> Lens:
    """Lens of librealsense: an `rs.intrinsics`, or anything with its attributes.

    Raises:
        SpecError: a distortion model that is not known.
    """
    name = str(getattr(values.model, "name", values.model)).rpartition(".")[2].lower()
    intrinsics = Intrinsics(
        int(values.width),
        int(values.height),
        values.fx,
        values.fy,
        values.ppx + HALF_PIXEL,
        values.ppy + HALF_PIXEL,
    )
    return realsense_distorted(intrinsics, name, values.coeffs)


def realsense_distorted(intrinsics: Intrinsics, model: str, coeffs: Sequence[float]) -> Lens:
    """Lens of a pinhole part and librealsense's names of models.

    Raises:
        SpecError: a distortion model that is not known.
    """
    names = {
        "none": "none",
        "brown_conrady": "brown",
        "modified_brown_conrady": "brown",
        "inverse_brown_conrady": "inverse_brown",
        "kannala_brandt4": "fisheye",
    }
    check_choice("model", model, tuple(names))
    values = [float(value) for value in coeffs]
    if names[model] == "none" or not any(values):
        return Lens(intrinsics)
    return Lens(intrinsics, names[model], tuple(values[: COEFFICIENTS[names[model]][-1]]))
