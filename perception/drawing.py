"""Pictures of what was measured: lines over the image, clustered cells, and the cross-section of figure 5(d)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from perception.geometry.lines import decode_cells, find_lines
from perception.geometry.results import DIRECTION_NAMES, StairEstimate
from stair_env.common.constants import IMAGE_SIZE
from stair_env.intrinsics import letterbox_padding

Colour = tuple[int, int, int]

CONVEX: Colour = (255, 140, 40)
CONCAVE: Colour = (70, 200, 255)
UNKNOWN: Colour = (170, 170, 170)
KIND_COLOURS: dict[str, Colour] = {"convex": CONVEX, "concave": CONCAVE, "unknown": UNKNOWN}
INK: Colour = (245, 245, 245)
DIM: Colour = (160, 168, 178)
PANEL: Colour = (24, 28, 34)
TRUE: Colour = (120, 220, 130)
FONT = cv2.FONT_HERSHEY_SIMPLEX
SECTION_SIZE_PX = (420, 300)
MAX_TEXT_STEPS = 4


def draw_estimate(rgb: np.ndarray, estimate: StairEstimate, truth: Mapping[str, Any] | None = None) -> np.ndarray:
    """Lines, sizes and distance over the image.

    Args:
        rgb: uint8 (H, W, 3), the image that was measured.
        estimate: of that image.
        truth: `info["truth"]` of the environment; its `step_width` and `step_height` are written beside the
            measurement.

    Returns:
        uint8 (H, W, 3), a new image.
    """
    image = np.ascontiguousarray(rgb).copy()
    scale = _text_scale(image)
    for line in estimate.lines:
        colour = KIND_COLOURS[line.kind]
        start, end = (round(line.x1), round(line.y1)), (round(line.x2), round(line.y2))
        cv2.line(image, start, end, (0, 0, 0), max(round(5 * scale), 3), cv2.LINE_AA)
        cv2.line(image, start, end, colour, max(round(3 * scale), 1), cv2.LINE_AA)
    _write_rows(image, _caption(estimate, truth), scale)
    return image


def _caption(estimate: StairEstimate, truth: Mapping[str, Any] | None) -> list[tuple[str, Colour]]:
    if not estimate.valid:
        return [(f"no stairs measured: {estimate.reason}", DIM)]
    direction = DIRECTION_NAMES[estimate.direction]
    rows = [(f"{direction}  edge {estimate.next_edge_m:.2f} m  yaw {np.degrees(estimate.yaw_rad):+.0f} deg", INK)]
    for number, step in enumerate(estimate.steps[:MAX_TEXT_STEPS], start=1):
        rows.append((f"step {number}: {1000 * step.width_m:.0f} x {1000 * step.height_m:.0f} mm", INK))
    if truth and truth.get("valid"):
        rows.append((f"true:   {1000 * truth['step_width']:.0f} x {1000 * truth['step_height']:.0f} mm", TRUE))
    return rows


def _text_scale(image: np.ndarray) -> float:
    return max(image.shape[1] / 800.0, 0.4)


def _write_rows(image: np.ndarray, rows: list[tuple[str, Colour]], scale: float) -> None:
    """Text on a dark panel in the upper left corner; drawn in place."""
    height, pad = round(26 * scale), round(10 * scale)
    widths = [cv2.getTextSize(text, FONT, 0.62 * scale, 1)[0][0] for text, _ in rows]
    right, bottom = min(max(widths) + 3 * pad, image.shape[1]), min(height * len(rows) + 2 * pad, image.shape[0])
    image[:bottom, :right] = (0.35 * image[:bottom, :right] + 0.65 * np.array(PANEL)).astype(np.uint8)
    for index, (text, colour) in enumerate(rows):
        origin = (round(1.5 * pad), pad + round((index + 0.75) * height))
        cv2.putText(image, text, origin, FONT, 0.62 * scale, colour, 1, cv2.LINE_AA)


def draw_clusters(rgb: np.ndarray, cls: np.ndarray, loc: np.ndarray) -> np.ndarray:
    """The network's segments, each in the colour of the line it was clustered to.

    Args:
        rgb: uint8 (H, W, 3).
        cls: (32, 16) class scores.
        loc: (32, 16, 8) coordinates within the cell.

    Returns:
        uint8 (H, W, 3), a new image.
    """
    image = np.ascontiguousarray(rgb).copy()
    height, width = image.shape[:2]
    left, top, side = letterbox_padding(width, height)
    segments, lines = decode_cells(cls, loc), find_lines(cls, loc)
    if len(lines) == 0:
        return image
    middle = (segments.ends[:, :2] + segments.ends[:, 2:]) / 2.0
    nearest = np.argmin(np.abs(lines[:, 4] * middle[:, :1] + lines[:, 5] - middle[:, 1:]), axis=1)
    ends = segments.ends * side / IMAGE_SIZE - np.array([left, top, left, top])
    for (x1, y1, x2, y2), index in zip(np.round(ends).astype(int).tolist(), nearest.tolist()):
        cv2.line(image, (x1, y1), (x2, y2), _palette(index), max(side // 160, 2), cv2.LINE_AA)
        cv2.circle(image, (x1, y1), max(side // 250, 1), INK, -1, cv2.LINE_AA)
    return image


def _palette(index: int) -> Colour:
    """Hues a golden angle apart, so that neighbours differ."""
    hue = np.uint8(int(index * 111) % 180)
    red, green, blue = cv2.cvtColor(np.array([[[hue, 200, 255]]], dtype=np.uint8), cv2.COLOR_HSV2RGB)[0, 0].tolist()
    return red, green, blue


def draw_section(estimate: StairEstimate, size: tuple[int, int] = SECTION_SIZE_PX) -> np.ndarray:
    """The cross-section of the stairs as measured: figure 5(d) of the paper.

    Args:
        estimate: what to draw.
        size: width and height of the picture, pixels.

    Returns:
        uint8 (height, width, 3).
    """
    width, height = size
    image = np.full((height, width, 3), PANEL, dtype=np.uint8)
    scale = width / 560.0
    cv2.putText(image, "cross-section, m", (10, round(24 * scale)), FONT, 0.6 * scale, DIM, 1, cv2.LINE_AA)
    outline = _outline(estimate)
    if len(outline) < 2:
        cv2.putText(image, "nothing measured", (10, height // 2), FONT, 0.6 * scale, DIM, 1, cv2.LINE_AA)
        return image
    points = np.concatenate([outline, [[0.0, 0.0]]])
    low, high = points.min(axis=0), points.max(axis=0)
    zoom = min((width - 60) / max(high[0] - low[0], 0.2), (height - 90) / max(high[1] - low[1], 0.2))

    def to_pixels(xz: np.ndarray) -> tuple[int, int]:
        return round(30 + (xz[0] - low[0]) * zoom), round(height - 30 - (xz[1] - low[1]) * zoom)

    pixels = np.array([to_pixels(point) for point in outline], dtype=np.int32)
    cv2.polylines(image, [pixels], False, INK, 2, cv2.LINE_AA)
    cv2.drawMarker(image, to_pixels(np.zeros(2)), DIM, cv2.MARKER_TRIANGLE_UP, round(14 * scale), 2, cv2.LINE_AA)
    cv2.putText(image, "camera", _beside(to_pixels(np.zeros(2))), FONT, 0.45 * scale, DIM, 1, cv2.LINE_AA)
    for nosing in estimate.nosings:
        place = to_pixels(np.array([nosing.distance_m, nosing.height_m]))
        cv2.circle(image, place, max(round(4 * scale), 2), CONVEX, -1, cv2.LINE_AA)
    for step in estimate.steps:
        text = f"{1000 * step.width_m:.0f}x{1000 * step.height_m:.0f}"
        nosing = min(estimate.nosings, key=lambda n, at=step.distance_m: abs(n.distance_m - at))  # type: ignore[misc]
        x, y = to_pixels(np.array([nosing.distance_m, nosing.height_m]))
        text_width = cv2.getTextSize(text, FONT, 0.5 * scale, 1)[0][0]
        left = x - text_width - 8 if estimate.direction > 0 else x + 8  # the free side of the outline
        cv2.putText(image, text, (left, y - round(8 * scale)), FONT, 0.5 * scale, CONVEX, 1, cv2.LINE_AA)
    return image


def _beside(pixel: tuple[int, int]) -> tuple[int, int]:
    return pixel[0] + 10, pixel[1] + 4


def _outline(estimate: StairEstimate) -> np.ndarray:
    """(n, 2) corners of the cross-section: forward, up, relative to the camera."""
    corners: list[tuple[float, float]] = []
    for index, nosing in enumerate(estimate.nosings):
        x, top = nosing.distance_m, nosing.height_m
        drop = nosing.riser_m if nosing.riser_m is not None else 0.0
        if index == 0:
            corners.append((max(x - 0.3, 0.0), top - drop if estimate.direction > 0 else top))
        if estimate.direction > 0:
            corners.extend([(x, top - drop), (x, top)])
        else:
            corners.extend([(x, top), (x, top - drop)])
    if corners:
        corners.append((corners[-1][0] + (estimate.nosings[-1].tread_m or 0.3), corners[-1][1]))
    return np.array(corners).reshape(-1, 2)


def draw_report(
    rgb: np.ndarray, estimate: StairEstimate, grid: tuple[np.ndarray, np.ndarray] | None = None
) -> np.ndarray:
    """Everything about one frame side by side: lines, clusters, cross-section.

    Args:
        rgb: uint8 (H, W, 3).
        estimate: of it.
        grid: the network's cls and loc; without it the clusters are left out.

    Returns:
        uint8 (H, W', 3).
    """
    height = rgb.shape[0]
    parts = [draw_estimate(rgb, estimate)]
    if grid is not None:
        parts.append(draw_clusters(rgb, *grid))
    parts.append(draw_section(estimate, (round(height * 1.1), height)))
    return np.concatenate(parts, axis=1)
