"""The SDK's post-processing of depth, on disparities: decimation, spatial, temporal, hole filling, in this order.

What each does is told in librealsense's documentation of its post-processing filters; the code is this project's own.
"""

from __future__ import annotations

import numpy as np

from stair_env.sensors.camera.stereo.config import HOLE_FILLINGS, StereoConfig

NEVER = (9, 8)
# For each of the SDK's persistency indices: so many readings among so many of the last frames.
PERSISTENCY = (NEVER, (8, 8), (2, 3), (2, 4), (2, 8), (1, 2), (1, 5), (1, 8), (0, 8))


def decimate(disparity: np.ndarray, factor: int) -> np.ndarray:
    """Merge squares of readings into the median of those that exist (mean from 4 x 4 on), as the SDK does.

    Args:
        disparity: float32 (H, W), 0 = no reading.
        factor: side of the squares; what does not fill one at the right and the bottom is cut off.

    Returns:
        float32 (H // factor, W // factor).
    """
    if factor == 1:
        return disparity
    height, width = (side // factor for side in disparity.shape)
    cut = disparity[: height * factor, : width * factor].reshape(height, factor, width, factor)
    cells = np.sort(np.moveaxis(cut, 1, 2).reshape(height, width, factor * factor), axis=-1)
    count = (cells > 0.0).sum(-1)
    if factor >= 4:
        return (cells.sum(-1) / np.maximum(count, 1)).astype(np.float32)
    # Sorted, the missing ones (0) come first: the lower median of the others.
    middle = factor * factor - count + (np.maximum(count, 1) - 1) // 2
    picked = np.take_along_axis(cells, np.minimum(middle, factor * factor - 1)[..., None], -1)[..., 0]
    return np.ascontiguousarray(np.where(count > 0, picked, 0.0).astype(np.float32))


class TemporalFilter:
    """Exponential average over frames that holds still where nothing moved.

    Args:
        alpha: weight of the new frame.
        delta_px: step of disparity that counts as another surface.
        persistency: 0 to 8, when a missing reading is replaced by the last one, see `StereoConfig`.
    """

    def __init__(self, alpha: float, delta_px: float, persistency: int = 0) -> None:
        self._alpha, self._delta = np.float32(alpha), np.float32(delta_px)
        seen = np.array([[index >> age & 1 for age in range(8)] for index in range(256)])  # bit 0: the newest frame
        needed, frames = PERSISTENCY[persistency]
        self._fills = seen[:, :frames].sum(1) >= needed
        self._last: np.ndarray | None = None
        self._history: np.ndarray | None = None

    def apply(self, disparity: np.ndarray) -> np.ndarray:
        """float32 (H, W) -> the same, averaged with what was seen before."""
        last, history = self._last, self._history
        if last is None or history is None or last.shape != disparity.shape:
            self._last, self._history = disparity.copy(), (disparity > 0.0).astype(np.uint8)
            return disparity
        seen = disparity > 0.0
        same = seen & (last > 0.0) & (np.abs(disparity - last) < self._delta)
        mixed = np.where(same, self._alpha * disparity + (1 - self._alpha) * last, disparity).astype(np.float32)
        self._history = (history << 1) | seen
        self._last = np.where(seen, mixed, last)
        return np.where(seen, mixed, np.where(self._fills[history], last, np.float32(0.0)))


def post_process(disparity: np.ndarray, config: StereoConfig, temporal: TemporalFilter | None = None) -> np.ndarray:
    """Run a configuration's filters.

    Args:
        disparity: float32 (H, W), 0 = no reading.
        config: which filters, and how strong.
        temporal: state of the temporal filter, None to leave it out.

    Returns:
        float32 (H // decimation, W // decimation), still pixels of the full image.
    """
    from stair_env.sensors.camera.stereo import kernels

    out = decimate(disparity, config.decimation)
    if config.spatial_alpha < 1.0:
        out = out.copy() if out is disparity else out
        for _ in range(config.spatial_passes):
            kernels.smooth_along(out.T, config.spatial_alpha, config.spatial_delta_px)
            kernels.smooth_along(out, config.spatial_alpha, config.spatial_delta_px)
    if temporal is not None and config.temporal_alpha < 1.0:
        out = temporal.apply(out)
    if config.hole_filling != "none":
        out = out.copy() if out is disparity else out
        kernels.fill_holes(out, HOLE_FILLINGS.index(config.hole_filling) - 1)
    return out
