"""From camera images to the network's input, shared by training and inference.

Images are padded with zeros around the centre to a square and scaled to 512 x 512 (paper, data set introduction).
Colour is scaled as (x / 255 - 0.5) / 0.5. Depth goes in as inverse depth: the image of a plane is then a linear
ramp, a stair edge a kink in it, and a stereo camera's noise has the same size everywhere.
"""

from __future__ import annotations

import cv2
import numpy as np

from stair_env.common.constants import IMAGE_SIZE
from stair_env.intrinsics import letterbox_padding

NEAREST_DEPTH_M = 0.35  # maps to the largest input value; a D435i on a dog sees its own floor from about 0.4 m
HOLE_NEIGHBOURS = 5  # of 8 that must have a reading: a straight rim of a large hole, with 3, stays where it is
HOLE_PASSES = 3


def letterbox(rgb: np.ndarray, depth_m: np.ndarray, size: int = IMAGE_SIZE) -> tuple[np.ndarray, np.ndarray]:
    """Pad with zeros around the centre to a square, then scale.

    Depth is never averaged across an edge: each pixel takes the reading nearest to its centre.

    Args:
        rgb: uint8 (H, W, 3).
        depth_m: float32 (H, W), metres, 0 = no reading.
        size: side of the result, pixels.

    Returns:
        uint8 (size, size, 3) and float32 (size, size); the inputs themselves where nothing has to change.
    """
    height, width = rgb.shape[:2]
    if (height, width) == (size, size):
        return rgb, np.asarray(depth_m, dtype=np.float32)
    left, top, side = letterbox_padding(width, height)
    if not any(length * size % side for length in (left, top, width, height)):  # the padding need not be scaled
        return _scale_inside(rgb, depth_m, side, size)
    square_rgb = np.zeros((side, side, 3), dtype=np.uint8)
    square_depth = np.zeros((side, side), dtype=np.float32)
    square_rgb[top : top + height, left : left + width] = rgb
    square_depth[top : top + height, left : left + width] = depth_m
    return _scale_inside(square_rgb, square_depth, side, size)


def _scale_inside(rgb: np.ndarray, depth_m: np.ndarray, side: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Images scaled by size / side, which gives whole pixels, in the middle of black squares."""
    height, width = rgb.shape[:2]
    left, top, _ = letterbox_padding(width, height)
    x, y, columns, rows = (length * size // side for length in (left, top, width, height))
    inside = slice(y, y + rows), slice(x, x + columns)
    square_rgb = np.zeros((size, size, 3), dtype=np.uint8)
    square_depth = np.zeros((size, size), dtype=np.float32)
    interpolation = cv2.INTER_AREA if side > size else cv2.INTER_LINEAR
    square_rgb[inside] = cv2.resize(rgb, (columns, rows), interpolation=interpolation)
    depth = np.asarray(depth_m, dtype=np.float32)
    square_depth[inside] = cv2.resize(depth, (columns, rows), interpolation=cv2.INTER_NEAREST_EXACT)
    return square_rgb, square_depth


def letterbox_lines(lines: np.ndarray, width: int, height: int, size: int = IMAGE_SIZE) -> np.ndarray:
    """Lines of a width x height image in pixels of its letterboxed form.

    Args:
        lines: (n, 4) x1 y1 x2 y2, pixels from the top left corner.
        width, height: of the image that the lines belong to.
        size: side of the letterboxed image, pixels.

    Returns:
        (n, 4) float64.
    """
    left, top, side = letterbox_padding(width, height)
    offset = np.array([left, top, left, top], dtype=np.float64)
    return (np.asarray(lines, dtype=np.float64).reshape(-1, 4) + offset) * (size / side)


def colour_input(rgb: np.ndarray) -> np.ndarray:
    """(B, H, W, 3) uint8 -> (B, 3, H, W) float32 in -1..1, contiguous."""
    batch, height, width, channels = rgb.shape
    scaled = np.empty((batch, channels, height, width), dtype=np.float32)
    for image, planes in zip(rgb, scaled):
        for channel, plane in zip(cv2.split(image), planes):
            np.multiply(channel, np.float32(2.0 / 255.0), out=plane)
    scaled -= np.float32(1.0)
    return scaled


def close_small_holes(depth_m: np.ndarray) -> np.ndarray:
    """Fill single missing readings with the mean of their neighbours; larger holes stay.

    A stereo matcher leaves per cents of its readings out one by one. To the network each would be a spike from here to
    infinity. A pixel is filled when most of its eight neighbours have a reading, and that is done a few times over.

    Args:
        depth_m: (H, W) metres, 0 = no reading; NaN counts as none.

    Returns:
        float32 (H, W); the argument itself where nothing is to fill.
    """
    depth = np.asarray(depth_m, dtype=np.float32)
    valid = depth > 0.0
    if valid.all():
        return depth
    for _ in range(HOLE_PASSES):
        count = cv2.boxFilter(valid.astype(np.uint8), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
        fill = (count >= HOLE_NEIGHBOURS) & ~valid
        if not fill.any():
            break
        seen = np.where(valid, depth, np.float32(0.0))
        total = cv2.boxFilter(seen, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
        depth = np.where(fill, total / np.maximum(count, 1), depth).astype(np.float32)
        valid = valid | fill
    return depth


def depth_input(depth_m: np.ndarray) -> np.ndarray:
    """(B, H, W) metres, 0 = no reading -> (B, 1, H, W) float32 in -1..1; no reading looks like infinitely far.

    Small holes are closed before (`close_small_holes`).
    """
    frames = np.asarray(depth_m, dtype=np.float32)
    depth = np.stack([close_small_holes(frame) for frame in frames]) if len(frames) else frames
    near = np.maximum(depth, np.float32(NEAREST_DEPTH_M))
    np.divide(np.float32(2.0 * NEAREST_DEPTH_M), near, out=near)
    near -= np.float32(1.0)
    np.copyto(near, np.float32(-1.0), where=~(depth > 0.0))  # NaN is no reading either
    return near[:, None]
