"""From a rectified infrared pair to disparities, by OpenCV's matchers."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from stair_env.sensors.camera.stereo.config import StereoConfig

SUBPIXELS = 16.0  # OpenCV's matchers count sixteenths of a pixel
BM_PRE_FILTER_CAP = 31


def make_matcher(config: StereoConfig) -> cv2.StereoMatcher:
    """OpenCV's matcher with a configuration's settings."""
    matcher: Any
    if config.matcher == "bm":
        matcher = cv2.StereoBM.create(config.max_disparity_px, max(config.block_px, 5))
        matcher.setPreFilterCap(BM_PRE_FILTER_CAP)
        matcher.setTextureThreshold(int(config.texture_threshold * 10))
        matcher.setUniquenessRatio(config.uniqueness)
    else:
        area = config.block_px**2
        matcher = cv2.StereoSGBM.create(
            minDisparity=0,
            numDisparities=config.max_disparity_px,
            blockSize=config.block_px,
            P1=round(config.smoothness[0] * area),
            P2=round(config.smoothness[1] * area),
            uniquenessRatio=config.uniqueness,
            mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )
    matcher.setDisp12MaxDiff(config.left_right_px)
    matcher.setSpeckleWindowSize(config.speckle_px)
    matcher.setSpeckleRange(config.speckle_range_px)
    return matcher


def match(
    left: np.ndarray, right: np.ndarray, config: StereoConfig, matcher: cv2.StereoMatcher, columns: slice = slice(None)
) -> np.ndarray:
    """Disparities of the left image.

    Args:
        left, right: uint8 (H, W), rectified.
        config: of the camera.
        matcher: `make_matcher(config)`; not to be used by two threads at once.
        columns: of the left image that are wanted.

    Returns:
        float32 (H, w), pixels, 0 = no match.
    """
    first, stop, _ = columns.indices(left.shape[1])
    # The matchers skip the columns in which the largest disparity would leave the right image. The device loses only
    # those whose own does, hence the columns that are put before the image, and the test for who needed them.
    begin = max(first - config.max_disparity_px, 0)
    before = config.max_disparity_px - (first - begin)
    wide = [cv2.copyMakeBorder(image[:, begin:stop], 0, 0, before, 0, cv2.BORDER_REPLICATE) for image in (left, right)]
    found = matcher.compute(*wide)[:, config.max_disparity_px :]
    found[found > np.int16(SUBPIXELS) * np.arange(first, stop, dtype=np.int16)] = 0
    disparity: np.ndarray = np.maximum(found, 0).astype(np.float32)
    disparity *= np.float32(1.0 / SUBPIXELS)
    if config.texture_threshold > 0.0 and config.matcher == "sgbm":
        disparity[_contrast(left[:, first:stop], config.block_px + 4) < config.texture_threshold] = 0.0
    return disparity


def _contrast(image: np.ndarray, side: int) -> np.ndarray:
    """(H, W) float32 mean horizontal contrast of a uint8 image around each pixel."""
    contrast = np.zeros(image.shape, np.uint8)
    cv2.absdiff(image[:, 1:], image[:, :-1], contrast[:, :-1])
    contrast[:, -1] = contrast[:, -2]
    return cv2.boxFilter(contrast, cv2.CV_32F, (side, side))
