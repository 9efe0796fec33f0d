"""Stair lines without learning: Gabor filters, Canny edges, probabilistic Hough transform (paper, table 6).

The paper names the three steps and no more. Here a bank of even Gabor filters, tuned to stripes near the horizontal,
answers to an edge with opposite signs on its two sides, so that the steepest place of the answer, which is what Canny
keeps, lies on the edge. Hough segments near the horizontal are then joined where they lie on one line.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import cv2
import numpy as np

from perception.data.label_grid import order_left_first
from perception.inference.preprocess import NEAREST_DEPTH_M
from stair_env.common.field_kinds import naming_fields
from stair_env.common.validation import check_choice

IMAGES = ("colour", "depth")
PADDING_LEVEL = 12  # grey levels: rows and columns at the rim that stay below are letterbox padding (or night)
RIM_PX = 4  # along the rim of the picture every filter sees the padding
GREY_PER_DEVIATION = 32.0  # grey levels that one standard deviation of the filter's answer becomes; 8 bits hold +-4
HOLE_PX = 9  # holes of the depth image up to about this size are closed before filtering


@dataclass(frozen=True)
class ClassicalParameters:
    """What the random search turns.

    Args:
        image: "colour" (grey values, the paper's use) or "depth" (inverse depth).
        wavelength_px: of the Gabor filter's wave, pixels.
        sigma_ratio: standard deviation of its envelope across the line, in wavelengths.
        elongation: how many times longer than wide the envelope is, along the line.
        spread_deg: filters stand at 0 and at plus and minus this many degrees from the horizontal.
        least_deviation: grey levels; a filter answer that varies less is not amplified further (near-black frames).
        canny_low, canny_high: hysteresis thresholds, in grey levels of the amplified answer (Sobel gradient).
        votes: least number of edge pixels on a Hough line.
        min_length_px: shortest segment, pixels.
        max_gap_px: largest gap within a segment, and between segments that are joined, pixels.
        max_slope_deg: largest angle to the horizontal, degrees.
        merge_px: segments closer than this, measured up and down, are one line, pixels.

    Raises:
        ValueError: a value is out of range; names field, value and range.
    """

    image: str = "colour"
    wavelength_px: float = 9.0
    sigma_ratio: float = 0.4
    elongation: float = 2.0
    spread_deg: float = 15.0
    least_deviation: float = 1.0
    canny_low: float = 60.0
    canny_high: float = 150.0
    votes: int = 40
    min_length_px: float = 50.0
    max_gap_px: float = 10.0
    max_slope_deg: float = 30.0
    merge_px: float = 6.0

    @naming_fields
    def __post_init__(self) -> None:
        check_choice("image", self.image, IMAGES)
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in LIMITS:
                low, high = LIMITS[field.name]
                if not low <= value <= high:
                    raise ValueError(f"{field.name}={value!r} must be a number in {low:g}..{high:g}")
        if self.canny_low > self.canny_high:
            raise ValueError(f"canny_low={self.canny_low!r} must not exceed canny_high={self.canny_high!r}")


LIMITS = {
    "wavelength_px": (2.0, 64.0),  # two pixels a wave: the sampling limit
    "sigma_ratio": (0.1, 2.0),
    "elongation": (0.2, 10.0),
    "spread_deg": (0.0, 45.0),
    "least_deviation": (0.01, 100.0),
    "canny_low": (0.0, 2000.0),
    "canny_high": (0.0, 2000.0),
    "votes": (1, 512),
    "min_length_px": (1.0, 512.0),
    "max_gap_px": (0.0, 512.0),
    "max_slope_deg": (1.0, 80.0),
    "merge_px": (0.0, 64.0),
}


class ClassicalDetector:
    """Gabor + Canny + Hough.

    Args:
        parameters: see `ClassicalParameters`.
    """

    def __init__(self, parameters: ClassicalParameters | None = None) -> None:
        self.parameters = parameters if parameters is not None else ClassicalParameters()
        self._kernels = gabor_kernels(self.parameters)

    def __call__(self, rgb: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
        """Find lines in an image pair; see `perception.reproduction.baselines.line_detector.LineDetector`."""
        return self._find(content_box(rgb), rgb, depth_m)

    def within(self, region: np.ndarray, rgb: np.ndarray, depth_m: np.ndarray, margin_px: int = 0) -> np.ndarray:
        """Find lines in a part of an image pair; nothing outside of it is looked at.

        Args:
            region: (4,) x1 y1 x2 y2, pixels, fractions allowed.
            rgb, depth_m: the whole images, see `perception.reproduction.baselines.line_detector.LineDetector`.
            margin_px: the region is widened by so many pixels on every side.

        Returns:
            (n, 4) lines, pixels of the whole image.
        """
        top, bottom, left, right = content_box(rgb)
        x1, y1 = np.floor(region[:2]).astype(int) - margin_px
        x2, y2 = np.ceil(region[2:]).astype(int) + margin_px
        box = max(top, int(y1)), min(bottom, int(y2)), max(left, int(x1)), min(right, int(x2))
        return self._find(box, rgb, depth_m)

    def _find(self, box: tuple[int, int, int, int], rgb: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
        p = self.parameters
        top, bottom, left, right = box
        if bottom - top < 3 * RIM_PX or right - left < 3 * RIM_PX:
            return np.zeros((0, 4))
        grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY) if p.image == "colour" else depth_picture(depth_m)
        edges = self.edges(grey[top:bottom, left:right])
        segments = hough_segments(edges, p) + np.array([left, top, left, top], dtype=np.float64)
        return merge_lines(near_horizontal(segments, p.max_slope_deg), p.merge_px, p.max_gap_px)

    def edges(self, grey: np.ndarray) -> np.ndarray:
        """Edge pixels of a grey picture without padding.

        Args:
            grey: uint8 (H, W).

        Returns:
            uint8 (H, W), 255 on edges; nothing within 4 pixels of the rim.
        """
        p = self.parameters
        answer = filter_answer(grey, self._kernels)
        gain = GREY_PER_DEVIATION / max(float(answer.std()), p.least_deviation)
        amplified = np.clip(128.0 + gain * answer, 0.0, 255.0).astype(np.uint8)
        edges = np.zeros_like(grey)
        inner = (slice(RIM_PX, -RIM_PX), slice(RIM_PX, -RIM_PX))
        edges[inner] = cv2.Canny(amplified, p.canny_low, p.canny_high, L2gradient=True)[inner]
        return edges


def gabor_kernels(parameters: ClassicalParameters) -> list[np.ndarray]:
    """Even Gabor filters with zero mean, float32 (k, k), their absolute values summing to 1."""
    sigma = parameters.sigma_ratio * parameters.wavelength_px
    side = 2 * int(np.ceil(2.5 * sigma * max(1.0, parameters.elongation))) + 1
    turns = (0.0,) if parameters.spread_deg == 0.0 else (-parameters.spread_deg, 0.0, parameters.spread_deg)
    kernels = []
    for turn in turns:
        theta = np.pi / 2 + np.radians(turn)  # of the wave's direction: across a horizontal line is 90 degrees
        kernel = cv2.getGaborKernel(
            (side, side), sigma, theta, parameters.wavelength_px, 1.0 / parameters.elongation, 0.0, cv2.CV_32F
        )
        kernel = kernel - kernel.mean()
        kernels.append((kernel / np.abs(kernel).sum()).astype(np.float32))
    return kernels


def filter_answer(grey: np.ndarray, kernels: list[np.ndarray]) -> np.ndarray:
    """Per pixel the answer of the filter that answers most, with its sign.

    Args:
        grey: uint8 (H, W).
        kernels: float32 (k, k) each.

    Returns:
        float32 (H, W).
    """
    answers = [cv2.filter2D(grey, cv2.CV_32F, kernel, borderType=cv2.BORDER_REPLICATE) for kernel in kernels]
    strongest = answers[0]
    for answer in answers[1:]:
        strongest = np.where(np.abs(answer) > np.abs(strongest), answer, strongest)
    return strongest


def content_box(rgb: np.ndarray) -> tuple[int, int, int, int]:
    """Rows top..bottom and columns left..right that hold the picture, without the padding of the letterbox.

    Args:
        rgb: uint8 (H, W, 3).

    Returns:
        (top, bottom, left, right), ends exclusive; (0, 0, 0, 0) for a black image.
    """
    bright = rgb.max(axis=2) > PADDING_LEVEL
    rows, columns = np.flatnonzero(bright.any(axis=1)), np.flatnonzero(bright.any(axis=0))
    if not len(rows):
        return 0, 0, 0, 0
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1


def depth_picture(depth_m: np.ndarray) -> np.ndarray:
    """Inverse depth as grey levels: planes become ramps, stair edges kinks and steps; small holes are closed.

    Args:
        depth_m: float32 (H, W), metres, 0 = no reading.

    Returns:
        uint8 (H, W).
    """
    with np.errstate(divide="ignore"):
        inverse = np.where(depth_m > 0.0, NEAREST_DEPTH_M / np.maximum(depth_m, NEAREST_DEPTH_M), 0.0)
    picture = (255.0 * inverse).astype(np.uint8)
    closed = cv2.morphologyEx(picture, cv2.MORPH_CLOSE, np.ones((HOLE_PX, HOLE_PX), np.uint8))
    return np.where(picture > 0, picture, closed)


def hough_segments(edges: np.ndarray, parameters: ClassicalParameters) -> np.ndarray:
    """Segments of the probabilistic Hough transform at 1 pixel and 1 degree.

    Args:
        edges: uint8 (H, W), non-zero on edges.
        parameters: votes, min_length_px and max_gap_px are used.

    Returns:
        (n, 4) float64, pixel centres at whole numbers + 0.5, left end first. OpenCV draws from a generator of its own
        with a fixed seed: the same picture gives the same segments.
    """
    found = cv2.HoughLinesP(
        edges,
        1.0,
        np.pi / 180.0,
        int(parameters.votes),
        minLineLength=parameters.min_length_px,
        maxLineGap=parameters.max_gap_px,
    )
    if found is None:
        return np.zeros((0, 4))
    return order_left_first(found.reshape(-1, 4).astype(np.float64) + 0.5)


def near_horizontal(lines: np.ndarray, max_slope_deg: float) -> np.ndarray:
    """Those of (n, 4) lines that lie within max_slope_deg of the horizontal."""
    lines = order_left_first(lines)
    run, rise = lines[:, 2] - lines[:, 0], np.abs(lines[:, 3] - lines[:, 1])
    return lines[(run > 0.0) & (rise <= run * np.tan(np.radians(max_slope_deg)))]


def merge_lines(lines: np.ndarray, merge_px: float, gap_px: float) -> np.ndarray:
    """Join segments that lie on one line, the longest first.

    A segment joins a line when both its ends lie within merge_px of it, measured along y, and the gap between the two
    along x is at most gap_px. The joint line is the least-squares line of all end points, weighted by length.

    Args:
        lines: (n, 4) pixels, left end first, none vertical.
        merge_px, gap_px: pixels.

    Returns:
        (m, 4), m <= n, left end first.
    """
    order = np.argsort(lines[:, 0] - lines[:, 2], kind="stable")
    groups: list[list[np.ndarray]] = []
    joint = np.zeros((0, 4))
    for line in lines[order]:
        index = _nearest_line(joint, line, merge_px, gap_px)
        if index is None:
            groups.append([line])
            joint = np.vstack([joint, line])
        else:
            groups[index].append(line)
            joint[index] = _joint_line(np.stack(groups[index]))
    return joint


def _nearest_line(joint: np.ndarray, line: np.ndarray, merge_px: float, gap_px: float) -> int | None:
    """Index of the line (m, 4) that a segment (4,) belongs to, or None."""
    if not len(joint):
        return None
    slope = (joint[:, 3] - joint[:, 1]) / (joint[:, 2] - joint[:, 0])
    ends = joint[:, 1, None] + slope[:, None] * (line[[0, 2]] - joint[:, 0, None])
    distance = np.abs(ends - line[[1, 3]]).max(axis=1)
    gap = np.maximum(joint[:, 0], line[0]) - np.minimum(joint[:, 2], line[2])
    distance[gap > gap_px] = np.inf
    best = int(distance.argmin())
    return best if distance[best] <= merge_px else None


def _joint_line(segments: np.ndarray) -> np.ndarray:
    """Least-squares line (4,) of segments (k, 4), weighted by length, over their whole extent."""
    x, y = segments[:, [0, 2]].ravel(), segments[:, [1, 3]].ravel()
    weight = np.repeat(segments[:, 2] - segments[:, 0], 2)
    mean_x, mean_y = np.average(x, weights=weight), np.average(y, weights=weight)
    slope = np.sum(weight * (x - mean_x) * (y - mean_y)) / np.sum(weight * (x - mean_x) ** 2)
    ends = np.array([x.min(), x.max()])
    fitted = mean_y + slope * (ends - mean_x)
    return np.array([ends[0], fitted[0], ends[1], fitted[1]])
