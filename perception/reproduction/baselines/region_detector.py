"""Classical line detection inside a region of interest that a network finds (paper, table 6: YOLOv5 + Gabor + Canny +
Hough)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import cv2
import numpy as np

from perception.inference.preprocess import colour_input
from perception.reproduction.baselines.classical import ClassicalDetector, ClassicalParameters, merge_lines
from stair_env.common.constants import IMAGE_SIZE

if TYPE_CHECKING:
    from perception.reproduction.baselines.region_network import RoiNetwork

LEAST_SIDE_PX = 8.0  # a lone line has a box of no height; boxes are widened to this
MAX_OVERLAP = 0.45  # IOU from which of two boxes the lower scored one goes: YOLOv5's value
MARGIN_PX = 10  # around a box: its first and last line lie on its rim, where filters see the cut

FindRegions = Callable[[np.ndarray], np.ndarray]  # uint8 (512, 512, 3) -> (n, 5) x1 y1 x2 y2 in pixels, score


def region_of(lines: np.ndarray, size: int = IMAGE_SIZE) -> np.ndarray | None:
    """The box around stair lines, cut to the image: what the region detector is taught.

    Args:
        lines: (n, 4) pixels.
        size: side of the image, pixels.

    Returns:
        (4,) float64 x1 y1 x2 y2, at least 8 pixels (of 512) wide and high; None without lines in the image.
    """
    ends = np.asarray(lines, dtype=np.float64).reshape(-1, 2)
    if not len(ends):
        return None
    low, high = np.clip(ends.min(axis=0), 0.0, size), np.clip(ends.max(axis=0), 0.0, size)
    if np.all(high <= low):
        return None
    short = np.maximum(LEAST_SIDE_PX * size / IMAGE_SIZE - (high - low), 0.0) / 2.0
    return np.concatenate([low - short, high + short])


class RegionFinder:
    """The region detector behind numpy.

    Args:
        network: trained; it is copied, batch norm folded.
        least_score: of a box.
        size_px: side of the image that the network sees, a multiple of 32; boxes are in pixels of the given image.

    Raises:
        ValueError: an argument is out of range.
    """

    def __init__(self, network: RoiNetwork, least_score: float, size_px: int = IMAGE_SIZE) -> None:
        import torch

        from perception.inference.batchnorm_fusion import folded

        if not 0.0 < least_score < 1.0:
            raise ValueError(f"least_score={least_score!r} must lie between 0 and 1")
        if size_px < 32 or size_px % 32:
            raise ValueError(f"size_px={size_px!r} must be a multiple of 32")
        self.least_score, self.size_px = least_score, size_px
        self._network = folded(network).to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def __call__(self, rgb: np.ndarray) -> np.ndarray:
        """Find stairs.

        Args:
            rgb: uint8 (512, 512, 3).

        Returns:
            (n, 5) float64 x1 y1 x2 y2 in pixels and the score, the best first; boxes that share their place are one.
        """
        import torch

        seen = rgb if len(rgb) == self.size_px else cv2.resize(rgb, (self.size_px,) * 2, interpolation=cv2.INTER_AREA)
        with torch.inference_mode():
            image = torch.from_numpy(colour_input(seen[None])).to(memory_format=torch.channels_last)
            found = self._network(image)[0].numpy().astype(np.float64)
        return suppress(found * np.array([*[rgb.shape[1], rgb.shape[0]] * 2, 1.0]), self.least_score)


def suppress(found: np.ndarray, least_score: float) -> np.ndarray:
    """Non-maximum suppression with OpenCV.

    Args:
        found: (n, 5) centre x, centre y, width, height in pixels, score.
        least_score: boxes below it go.

    Returns:
        (m, 5) x1 y1 x2 y2, score, the best first.
    """
    boxes = np.concatenate([found[:, :2] - found[:, 2:4] / 2.0, found[:, 2:4]], axis=1)
    kept = cv2.dnn.NMSBoxes(boxes.tolist(), found[:, 4].tolist(), least_score, MAX_OVERLAP)
    index = np.asarray(kept, dtype=np.int64).reshape(-1)
    corners = np.concatenate([boxes[index, :2], boxes[index, :2] + boxes[index, 2:]], axis=1)
    return np.concatenate([corners, found[index, 4:5]], axis=1)


class RoiClassicalDetector:
    """Gabor + Canny + Hough within found regions (`perception.reproduction.baselines.line_detector.LineDetector`).

    Args:
        find: finds the regions.
        parameters: of the classical detector.
    """

    def __init__(self, find: FindRegions, parameters: ClassicalParameters | None = None) -> None:
        self.find, self._classical = find, ClassicalDetector(parameters)

    def __call__(self, rgb: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
        """Find lines; none where no region is found."""
        return self.within(self.find(rgb), rgb, depth_m)

    def within(self, regions: np.ndarray, rgb: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
        """Find lines in given regions.

        Args:
            regions: (n, >= 4) x1 y1 x2 y2, pixels.
            rgb, depth_m: see `perception.reproduction.baselines.line_detector.LineDetector`.

        Returns:
            (m, 4) lines, pixels.
        """
        found = [self._classical.within(region[:4], rgb, depth_m, MARGIN_PX) for region in regions]
        if len(found) < 2:
            return found[0] if found else np.zeros((0, 4))
        p = self._classical.parameters
        return merge_lines(np.concatenate(found), p.merge_px, p.max_gap_px)
