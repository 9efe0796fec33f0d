"""Intrinsics and extrinsics from files: our JSON, librealsense's JSON, ROS `camera_info` YAML.

A file of ours has fx, fy, cx, cy in the package's pixels. librealsense writes ppx, ppy and coeffs, ROS a matrix named
K, k or camera_matrix; both count from the first pixel's centre (see `perception.lens.lenses`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from perception.lens.lenses import HALF_PIXEL, Lens, realsense_distorted, ros_lens
from stair_env.intrinsics import Intrinsics

OURS, SDK = ("fx", "fy", "cx", "cy"), ("fx", "fy", "ppx", "ppy")
ROTATION_TOLERANCE = 1e-3


class CalibrationError(ValueError):
    """A calibration does not fit; the message names the file and what is wrong."""


def read_lens(path: Path, width: int, height: int) -> Lens:
    """A lens from a file, for images of a size.

    Args:
        path: JSON or YAML.
        width, height: of the images; a file that states another size of the same shape is scaled.

    Raises:
        CalibrationError: the file holds no intrinsics, or those of images of another shape.
        OSError: it cannot be read.
    """
    return lens_from_values(read_object(path), width, height, str(path))


def read_object(path: Path) -> dict[str, Any]:
    """The mapping in a JSON or YAML file.

    Raises:
        CalibrationError: it holds none.
        OSError: it cannot be read.
    """
    import yaml

    try:
        text = path.read_text(encoding="utf-8")
        values = json.loads(text) if path.suffix.lower() == ".json" else yaml.safe_load(text)
    except (json.JSONDecodeError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise CalibrationError(f"{path}: not JSON or YAML: {' '.join(str(error).split())}") from None
    if not isinstance(values, dict):
        raise CalibrationError(f"{path}: must be an object with fx, fy, cx, cy (or ppx, ppy; or a camera_info)")
    return values


def lens_from_values(values: Mapping[str, Any], width: int, height: int, where: str) -> Lens:
    """A lens from a mapping in any of the three forms; see `read_lens`."""
    try:
        lens = _read(values, width, height)
    except (ValueError, TypeError, KeyError, IndexError, OverflowError) as error:  # SpecError is a ValueError
        raise CalibrationError(f"{where}: {error}") from None
    if lens is None:
        raise CalibrationError(
            f"{where}: has neither fx, fy, cx, cy nor fx, fy, ppx, ppy (librealsense) nor K or camera_matrix (ROS)"
        )
    model = lens.intrinsics
    if (model.width, model.height) != (width, height):
        if model.width * height != model.height * width:
            raise CalibrationError(
                f"{where}: intrinsics are those of {model.width}x{model.height} images, these are {width}x{height}"
            )
        lens = lens.scaled(width, height)
    model = lens.intrinsics
    if not (0.0 <= model.cx <= width and 0.0 <= model.cy <= height):
        raise CalibrationError(
            f"{where}: cx={model.cx:g}, cy={model.cy:g} lie outside the {width}x{height} image; are these the "
            "intrinsics of another resolution?"
        )
    return lens


def _read(values: Mapping[str, Any], width: int, height: int) -> Lens | None:
    size = (
        int(values.get("width", values.get("image_width", width))),
        int(values.get("height", values.get("image_height", height))),
    )
    if all(name in values for name in OURS):
        model = Intrinsics(*size, *(values[name] for name in OURS))
        return Lens(model, values.get("distortion", "none"), tuple(values.get("coefficients", ())))
    if all(name in values for name in SDK):
        fx, fy, ppx, ppy = (float(values[name]) for name in SDK)
        model = Intrinsics(*size, fx, fy, ppx + HALF_PIXEL, ppy + HALF_PIXEL)
        named = str(values.get("model", "brown_conrady")).rpartition(".")[2].lower().replace(" ", "_")
        return realsense_distorted(model, named, values.get("coeffs", ()))
    for name in ("K", "k", "camera_matrix"):
        if name in values:
            d = next((values[key] for key in ("D", "d", "distortion_coefficients") if key in values), ())
            return ros_lens(
                *size, _numbers(values[name]), str(values.get("distortion_model", "plumb_bob")), _numbers(d)
            )
    return None


def _numbers(value: Any) -> list[float]:
    """A list, or what ROS's calibrator writes: {rows, cols, data}."""
    return [float(item) for item in np.ravel(value["data"] if isinstance(value, Mapping) else value)]


def lens_to_dict(lens: Lens) -> dict[str, Any]:
    """JSON form that `lens_from_values` reads."""
    values: dict[str, Any] = dict(lens.intrinsics.to_dict())
    if not lens.is_pinhole:
        values.update(distortion=lens.distortion, coefficients=list(lens.coefficients))
    return values


def read_extrinsics(path: Path) -> np.ndarray:
    """(4, 4) depth_to_colour from a JSON or YAML file with `rotation` (nine numbers, row by row, or three rows) and
    `translation` (three, metres).

    Raises:
        CalibrationError: it holds no rigid transform.
        OSError: it cannot be read.
    """
    values = read_object(path)
    try:
        rotation = np.array(values["rotation"], np.float64).reshape(3, 3)
        translation = np.array(values["translation"], np.float64).reshape(3)
    except (KeyError, TypeError, ValueError):
        raise CalibrationError(f"{path}: must hold rotation (nine numbers) and translation (three, metres)") from None
    return rigid(rotation, translation, str(path))


def rigid(rotation: np.ndarray, translation: np.ndarray, where: str) -> np.ndarray:
    """(4, 4) float64 from a rotation (3, 3) and a translation (3,), metres.

    Raises:
        CalibrationError: the rotation is none, or the translation is metres long.
    """
    off = np.abs(rotation @ rotation.T - np.eye(3)).max() if np.isfinite(rotation).all() else np.inf
    if off > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
        raise CalibrationError(f"{where}: rotation is none ({rotation.tolist()})")
    if not np.linalg.norm(translation) < 1.0:
        raise CalibrationError(
            f"{where}: translation={translation.tolist()} must be metres between two cameras of one device"
        )
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation, translation
    return transform
