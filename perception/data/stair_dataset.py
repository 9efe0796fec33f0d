"""Reads labelled RGB-D sets: those of `stair-env dataset` and the public one of the paper alike.

Both have the folders `images`, `depthes` and `labels`. Ours adds a JSON side-car beside each image and holds depth as
16-bit millimetres; the public set has no side-car and 8-bit depth of unstated scale.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from perception.data.label_grid import order_left_first, read_label_file
from stair_env.common.constants import IMAGE_SIZE
from stair_env.common.images import read_image

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
MILLIMETRE = 0.001
DEPTHS = "depthes"  # folder name of the public set
# Metres a grey level of 8-bit depth. The public set states none: stairs one to two metres away lie at levels 151 to 255
# there, which is 6.6 to 7.8 mm. `perception.looking.grey_scale` estimates it from frames.
GREY_LEVEL_M = 0.007


class DatasetError(ValueError):
    """A data set is incomplete or a file cannot be used; the message names the file."""


@dataclass(frozen=True)
class Sample:
    """One labelled frame.

    Attributes:
        rgb: uint8 (512, 512, 3).
        depth_m: float32 (512, 512), metres, 0 = no reading.
        kinds: (n,) int64, 0 convex, 1 concave.
        lines: (n, 4) float64, pixels, left end first.
        meta: the side-car, empty without one.
    """

    rgb: np.ndarray
    depth_m: np.ndarray
    kinds: np.ndarray
    lines: np.ndarray
    meta: dict[str, Any] = field(default_factory=dict)

    @property
    def lighting(self) -> str:
        """ "day" or "night"; "unknown" without a side-car."""
        return str(self.meta.get("lighting", "unknown"))

    @property
    def view(self) -> str:
        """ "ascending", "descending", "none" (no line in view), or "unknown" without a side-car."""
        return "none" if not len(self.lines) else str(self.meta.get("view", "unknown"))


class StairDataset:
    """Frames of one folder, by index.

    Args:
        root: folder that holds `images`, `depthes` and `labels`, or holds one such folder per split.
        split: name of that folder ("train", "val", "test"), or None when root itself is it.
        grey_level_m: metres that a grey level of 8-bit depth stands for.
        depth_folder: where the frames' depth comes from: "depthes", or a folder of matched depth beside it.

    Raises:
        DatasetError: a folder is missing or empty, or an image lacks its depth or its labels.
    """

    def __init__(
        self,
        root: str | Path,
        split: str | None = None,
        grey_level_m: float = GREY_LEVEL_M,
        depth_folder: str = DEPTHS,
    ) -> None:
        self.folder = Path(root) / split if split else Path(root)
        self._grey_level_m, self._depth_folder = grey_level_m, depth_folder
        for name in ("images", DEPTHS, "labels", depth_folder):
            if not (self.folder / name).is_dir():
                raise DatasetError(f"{self.folder / name}: no such folder; a data set has images, depthes and labels")
        paths = (self.folder / "images").iterdir()
        self.images = sorted(p for p in paths if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith("."))
        if not self.images:
            raise DatasetError(f"{self.folder / 'images'}: holds no {', '.join(IMAGE_SUFFIXES)} image")
        for image in self.images:
            for twin in (self._depth_path(image), self._label_path(image)):
                if not twin.is_file():
                    raise DatasetError(f"{image}: its twin {twin} is missing")

    def _depth_path(self, image: Path, folder: str = DEPTHS) -> Path:
        return self.folder / folder / f"{image.stem}.png"

    @cached_property
    def matched_folders(self) -> tuple[str, ...]:
        """Folders beside `depthes` with depth matched from infrared pairs of the same frames."""
        return tuple(sorted(path.name for path in self.folder.glob("depthes_*") if path.is_dir()))

    def _label_path(self, image: Path) -> Path:
        return self.folder / "labels" / f"{image.stem}.txt"

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, index: int) -> Sample:
        """Read one frame; see `frame`."""
        return self.frame(index, self._depth_folder)

    def depth(self, index: int, folder: str = DEPTHS) -> np.ndarray:
        """float32 (512, 512) metres of one frame, 0 = no reading.

        Args:
            index: of the frame.
            folder: "depthes", or one of `matched_folders`.

        Raises:
            DatasetError: the file cannot be read or has a wrong size.
        """
        path = self._depth_path(self.images[index], folder)
        depth = read_depth(path, grey_level_m=self._grey_level_m)
        _check_size(depth, path)
        return depth

    def frame(self, index: int, depth_folder: str = DEPTHS) -> Sample:
        """Read one frame.

        Args:
            index: of the frame.
            depth_folder: see `depth`.

        Raises:
            DatasetError: a file cannot be read or has a wrong size; LabelError: a malformed label. Both name the file.
            IndexError: no such frame.
        """
        image = self.images[index]
        kinds, lines = read_label_file(self._label_path(image))
        rgb = read_colour(image)
        _check_size(rgb, image)
        depth = self.depth(index, depth_folder)
        return Sample(rgb, depth, kinds, order_left_first(lines), read_side_car(image.with_suffix(".json")))

    def side_car(self, index: int) -> dict[str, Any]:
        """The side-car alone, without reading images; empty when there is none."""
        return read_side_car(self.images[index].with_suffix(".json"))


def _check_size(array: np.ndarray, path: Path) -> None:
    if array.shape[:2] != (IMAGE_SIZE, IMAGE_SIZE):
        raise DatasetError(f"{path}: {array.shape[1]}x{array.shape[0]} pixels, must be {IMAGE_SIZE}x{IMAGE_SIZE}")


def read_colour(path: str | Path) -> np.ndarray:
    """uint8 (H, W, 3) RGB.

    Raises:
        DatasetError: the file is missing or no image.
    """
    image = decode_image(path, cv2.IMREAD_COLOR)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def read_depth(path: str | Path, *, unit_m: float = MILLIMETRE, grey_level_m: float = GREY_LEVEL_M) -> np.ndarray:
    """float32 (H, W) metres, 0 = no reading.

    Args:
        path: 16-bit png in units of unit_m, or 8-bit as in the public set; of three equal channels one counts.
        unit_m: metres a unit of 16-bit depth.
        grey_level_m: metres a grey level of 8-bit depth.

    Raises:
        DatasetError: the file is missing, no image, one in colour, or neither 8- nor 16-bit.
    """
    image = decode_image(path, cv2.IMREAD_UNCHANGED)
    if image.ndim == 3:
        if image.shape[2] >= 3 and not (image[..., :3] == image[..., :1]).all():
            raise DatasetError(
                f"{path}: three different channels, which is a colourised picture and no depth; save depth as 16-bit "
                "png (Z16), or as 8-bit grey"
            )
        image = image[..., 0]
    scales = {np.dtype(np.uint16): unit_m, np.dtype(np.uint8): grey_level_m}
    if image.dtype not in scales:
        raise DatasetError(f"{path}: depth of type {image.dtype}, must be 8- or 16-bit")
    return image.astype(np.float32) * np.float32(scales[image.dtype])


def decode_image(path: str | Path, flags: int) -> np.ndarray:
    """Decode an image file, whatever its name.

    Args:
        path: of the file.
        flags: of `cv2.imdecode`.

    Raises:
        DatasetError: the file is missing or no image.
    """
    try:
        return read_image(path, flags)
    except (OSError, ValueError) as error:
        told = f"{path}: {error.strerror or error}" if isinstance(error, OSError) else str(error)
        raise DatasetError(told) from None


def read_side_car(path: Path) -> dict[str, Any]:
    """The JSON object in a file, or an empty one when there is no file.

    Raises:
        DatasetError: the file holds no JSON object.
    """
    if not path.is_file():
        return {}
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise DatasetError(f"{path}: cannot be read: {error}") from error
    if not isinstance(values, dict):
        raise DatasetError(f"{path}: must hold a JSON object, holds {type(values).__name__}")
    return values
