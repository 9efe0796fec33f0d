"""From camera images to the network's input, shared by training and inference.

Images are padded with zeros around the centre to a square and scaled to 512 x 512 (paper, data set introduction).
Colour is scaled as (x / 255 - 0.5) / 0.5. Depth goes in as inverse depth: the image of a plane is then a linear
ramp, a stair edge a kink in it, and a stereo camera's noise has the same size everywhere.
"""

from __future__ import annotations

import cv2
import numpy as np

from stair_env.camera.intrinsics import letterbox_padding

IMAGE_SIZE = 512
NEAREST_DEPTH_M = 0.35  # maps to the largest input value; a D435i on a dog sees its own floor from about 0.4 m


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
    shrinks = side > size
    square_rgb = np.zeros((side, side, 3), dtype=np.uint8)
    square_depth = np.zeros((side, side), dtype=np.float32)
    square_rgb[top : top + height, left : left + width] = rgb
    square_depth[top : top + height, left : left + width] = depth_m
    if side == size:
        return square_rgb, square_depth
    scaled_rgb = cv2.resize(square_rgb, (size, size), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    scaled_depth = cv2.resize(square_depth, (size, size), interpolation=cv2.INTER_NEAREST_EXACT)
    return scaled_rgb, scaled_depth


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
    planes = np.ascontiguousarray(np.moveaxis(rgb, -1, 1))
    return np.multiply(planes, np.float32(2.0 / 255.0), dtype=np.float32) - np.float32(1.0)


def depth_input(depth_m: np.ndarray) -> np.ndarray:
    """(B, H, W) metres, 0 = no reading -> (B, 1, H, W) float32 in -1..1; no reading looks like infinitely far."""
    depth = np.asarray(depth_m, dtype=np.float32)
    distance = np.where(depth > 0.0, np.maximum(depth, np.float32(NEAREST_DEPTH_M)), np.float32(np.inf))
    return (np.float32(2.0 * NEAREST_DEPTH_M) / distance - np.float32(1.0))[:, None]
