"""From a rectified infrared pair to disparities, by OpenCV's matchers."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from stair_env.camera.stereo.config import StereoConfig

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


def match(left: np.ndarray, right: np.ndarray, config: StereoConfig, matcher: cv2.StereoMatcher) -> np.ndarray:
    """Disparities of the left image.

    Args:
        left, right: uint8 (H, W), rectified.
        config: of the camera.
        matcher: `make_matcher(config)`; not to be used by two threads at once.

    Returns:
        float32 (H, W), pixels, 0 = no match.
    """
    disparity = matcher.compute(left, right).astype(np.float32) * np.float32(1.0 / SUBPIXELS)
    if config.texture_threshold > 0.0 and config.matcher == "sgbm":
        contrast: np.ndarray = cv2.absdiff(left[:, 1:], left[:, :-1]).astype(np.float32)
        contrast = cv2.copyMakeBorder(contrast, 0, 0, 0, 1, cv2.BORDER_REPLICATE)
        side = config.block_px + 4
        disparity[cv2.boxFilter(contrast, -1, (side, side)) < config.texture_threshold] = 0.0
    np.maximum(disparity, 0.0, out=disparity)
    return disparity
