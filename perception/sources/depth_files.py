"""Depth images of every kind that people have: PNG, PGM and TIFF of whole numbers, NPY, TIFF and EXR of metres."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from perception.data.stair_dataset import GREY_LEVEL_M, MILLIMETRE, DatasetError, decode_image
from perception.sources.hints import COLOURISED, GREY_DEPTH

COLOUR_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm", ".bmp")
DEPTH_SUFFIXES = (".png", ".npy", ".tif", ".tiff", ".exr", ".pgm", ".jpg", ".jpeg")
EXR_DEPTH = ("Z", "depth", "Y")  # channels that are depth where there are others
SAME_CHANNELS = 3  # grey levels by which the channels of a grey picture differ after JPEG


@dataclass(frozen=True)
class DepthFile:
    """A depth image and what is odd about it.

    Attributes:
        depth_m: float32 (H, W) metres, 0 = no reading; None when the file is no depth.
        hints: in words.
    """

    depth_m: np.ndarray | None
    hints: tuple[str, ...] = ()


def read_depth_file(path: Path, unit_m: float = MILLIMETRE, grey_level_m: float | None = None) -> DepthFile:
    """Read a depth image.

    Args:
        path: whole numbers of 16 or 32 bits are units, floating point numbers metres, 8 bits grey levels.
        unit_m: metres a unit.
        grey_level_m: metres a grey level; None takes the public set's, and says so in a hint.

    Raises:
        DatasetError: the file cannot be read, or holds no image of one channel.
    """
    image = _load(path)
    if image.ndim == 3 and image.shape[2] >= 3:
        channels = image[..., :3].astype(np.int64) if image.dtype != np.float32 else image[..., :3]
        if np.abs(channels.max(axis=2) - channels.min(axis=2)).max() > SAME_CHANNELS:
            return DepthFile(None, (COLOURISED,))
    if image.ndim == 3:
        image = image[..., 0]
    if image.ndim != 2 or image.size == 0:
        raise DatasetError(f"{path}: has shape {image.shape}, depth is (H, W)")
    if image.dtype == np.uint8:
        level = GREY_LEVEL_M if grey_level_m is None else grey_level_m
        return DepthFile(image.astype(np.float32) * np.float32(level), () if grey_level_m else (GREY_DEPTH,))
    if np.issubdtype(image.dtype, np.integer):
        return DepthFile(image.astype(np.float32) * np.float32(unit_m))
    if np.issubdtype(image.dtype, np.floating):
        depth = image.astype(np.float32)
        return DepthFile(np.where(np.isfinite(depth) & (depth > 0.0), depth, np.float32(0.0)))
    raise DatasetError(f"{path}: depth of type {image.dtype}, must be whole numbers or floating point")


def _load(path: Path) -> np.ndarray:
    if path.suffix.lower() == ".npy":
        try:
            return np.asarray(np.load(path, allow_pickle=False))
        except (OSError, ValueError, EOFError) as error:
            raise DatasetError(f"{path}: cannot be read as an array: {error}") from None
    if path.suffix.lower() == ".exr":
        return _load_exr(path)
    import cv2

    return decode_image(path, cv2.IMREAD_UNCHANGED)


def _load_exr(path: Path) -> np.ndarray:
    """By OpenEXR's own library, else by an OpenCV that was built with it (PyPI's, from 5.0 on, is not)."""
    try:
        import OpenEXR
    except ModuleNotFoundError:
        os.environ.setdefault("OPENCV_IO_ENABLE_OPENEXR", "1")  # off by default; read when the first EXR file is
        import cv2

        if not cv2.haveImageReader(str(path)):
            raise DatasetError(
                f"{path}: cannot be read as an image; is it EXR, pip install 'stair-env[exr]' brings its library"
            ) from None
        return decode_image(path, cv2.IMREAD_UNCHANGED)
    if not path.is_file():
        raise DatasetError(f"{path}: no such file")
    try:
        with OpenEXR.File(os.fspath(path)) as file:
            channels = {name: channel.pixels for name, channel in file.channels().items()}
    except Exception as error:  # its errors share no base class
        raise DatasetError(f"{path}: cannot be read as EXR: {' '.join(str(error).split())}") from None
    found = [channels[name] for name in (*EXR_DEPTH, *channels) if channels.get(name) is not None]
    if not found:  # a file that is cut has names and no pixels
        raise DatasetError(f"{path}: cannot be read as EXR: holds no pixels")
    return np.asarray(found[0])


def is_grey_16_bit(path: Path) -> bool:
    """Whether an image file has one channel of 16 bits, which no colour image has."""
    image = _load(path)
    return image.ndim == 2 and image.dtype != np.uint8
