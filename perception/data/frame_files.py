"""RGB-D frames from files: what `stair-env perceive` reads.

Beside a colour image `name.png` an optional `name.json` may hold fx, fy, cx, cy (pixels of that image), gravity (the
accelerometer at rest, camera frame) and depth_scale (metres a unit of 16-bit depth); it overrides the options.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from perception.data.stair_dataset import IMAGE_SUFFIXES, MILLIMETRE, read_colour, read_depth, read_side_car
from perception.estimator import check_gravity
from stair_env.common.constants import LEVEL_CAMERA_GRAVITY
from stair_env.common.validation import SpecError
from stair_env.intrinsics import D435I_COLOR_MODES, Intrinsics

INTRINSICS_KEYS = ("fx", "fy", "cx", "cy")
D435I_ROWS = 480


class FrameFileError(ValueError):
    """A frame cannot be read; the message names the file and what is wrong."""


@dataclass(frozen=True)
class FrameOptions:
    """What is taken where no side-car says otherwise.

    Attributes:
        intrinsics: fx, fy, cx, cy in pixels; None assumes a D435i's colour camera.
        gravity: accelerometer at rest, camera frame; level by default.
        depth_scale_m: metres a unit of 16-bit depth.
    """

    intrinsics: dict[str, float] | None = None
    gravity: tuple[float, float, float] = LEVEL_CAMERA_GRAVITY
    depth_scale_m: float = MILLIMETRE


@dataclass(frozen=True)
class FrameFile:
    """A frame as `StairEstimator.estimate` takes it.

    Attributes:
        name: of the colour image, without folder and ending.
        rgb: uint8 (H, W, 3).
        depth_m: float32 (H, W).
        intrinsics: of both.
        gravity: (3,).
    """

    name: str
    rgb: np.ndarray
    depth_m: np.ndarray
    intrinsics: Intrinsics
    gravity: np.ndarray


def pair_files(rgb: Path, depth: Path) -> list[tuple[Path, Path]]:
    """Colour and depth files that belong together.

    Args:
        rgb, depth: two files, or two folders whose images share names (endings aside).

    Raises:
        FrameFileError: one is missing, one is a file and the other a folder, or an image lacks its twin.
    """
    for path in (rgb, depth):
        if not path.exists():
            raise FrameFileError(f"{path}: no such file or folder")
    if rgb.is_dir() != depth.is_dir():
        raise FrameFileError(f"{rgb} and {depth} must both be files or both be folders")
    if rgb.is_file():
        return [(rgb, depth)]
    colours = sorted(path for path in rgb.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    depths = {path.stem: path for path in depth.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES}
    if not colours:
        raise FrameFileError(f"{rgb}: holds no image ({', '.join(IMAGE_SUFFIXES)})")
    for path in colours:
        if path.stem not in depths:
            raise FrameFileError(f"{depth}: lacks a depth image named {path.stem}")
    return [(path, depths[path.stem]) for path in colours]


def read_frame(rgb_path: Path, depth_path: Path, options: FrameOptions) -> FrameFile:
    """Read one frame and its side-car, if there is one.

    Raises:
        FrameFileError: sizes differ, or intrinsics or gravity are no numbers that fit.
        ValueError: an image cannot be read.
    """
    side_car = rgb_path.with_suffix(".json")
    meta: dict[str, Any] = read_side_car(side_car) if side_car.is_file() else {}
    where = side_car if meta else rgb_path
    rgb = read_colour(rgb_path)
    depth = read_depth(depth_path, unit_m=_number(meta.get("depth_scale", options.depth_scale_m), "depth_scale", where))
    if depth.shape != rgb.shape[:2]:
        raise FrameFileError(
            f"{depth_path} is {depth.shape[1]}x{depth.shape[0]}, {rgb_path} is {rgb.shape[1]}x{rgb.shape[0]}; "
            "depth must be aligned to colour"
        )
    given = {key: meta[key] for key in INTRINSICS_KEYS if key in meta} or options.intrinsics
    try:
        gravity = check_gravity(meta.get("gravity", options.gravity))
    except (TypeError, ValueError) as error:
        raise FrameFileError(f"{where}: {error}") from None
    return FrameFile(rgb_path.stem, rgb, depth, _intrinsics(given, rgb.shape[1], rgb.shape[0], where), gravity)


def _number(value: Any, name: str, where: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value < 1.0:
        raise FrameFileError(f"{where}: {name}={value!r} must be metres a unit of depth, between 0 and 1")
    return float(value)


def _intrinsics(given: dict[str, float] | None, width: int, height: int, where: Path) -> Intrinsics:
    """The given numbers for an image of this size, or those of a D435i."""
    if given is None:
        return d435i_intrinsics(width, height)
    missing = [key for key in INTRINSICS_KEYS if key not in given]
    if missing:
        raise FrameFileError(f"{where}: intrinsics lack {', '.join(missing)}; needed are {', '.join(INTRINSICS_KEYS)}")
    try:
        model = Intrinsics(width, height, *(given[key] for key in INTRINSICS_KEYS))
    except SpecError as error:
        raise FrameFileError(f"{where}: {error}") from None
    if not (0.0 <= model.cx <= width and 0.0 <= model.cy <= height):
        raise FrameFileError(f"{where}: cx={model.cx:g}, cy={model.cy:g} lie outside the {width}x{height} image")
    return model


def d435i_intrinsics(width: int, height: int) -> Intrinsics:
    """Nominal intrinsics of a D435i's colour image: of a mode, of a scaled mode, or of a letterboxed square."""
    if width == height:
        return D435I_COLOR_MODES["640x480"].letterboxed(width)
    for mode in D435I_COLOR_MODES.values():
        if width * mode.height == height * mode.width:
            return mode.scaled(width, height)
    focal = D435I_COLOR_MODES["640x480"].fy * height / D435I_ROWS
    return Intrinsics(width, height, focal, focal, width / 2.0, height / 2.0)
