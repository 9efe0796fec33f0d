"""The paper's figure 7 on our frames: what each method of table 6 finds, side by side."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from perception.data.stair_dataset import Sample, StairDataset
from perception.drawing import FONT, INK, PANEL, TRUE, Colour
from perception.reproduction.baselines.line_detector import LineDetector
from perception.reproduction.baselines.region_detector import FindRegions

VIEWS, LIGHTS = ("ascending", "descending"), ("day", "night")
LEAST_LINES = 4  # of a frame that is shown
FOUND: Colour = (255, 120, 40)
REGION: Colour = (90, 180, 255)
SHOWN_MEAN = 90.0  # grey levels: darker frames are shown brighter, or a reader sees nothing
MAX_GAIN = 6.0
TILE_PX = 192
TITLE_PX = 22
GAP_PX = 4


def exemplary_frames(frames: StairDataset, each: int = 1) -> list[Sample]:
    """The first frames of the set of each view and light that show some stair lines, and the first without any."""
    wanted = {(view, light): each for view, light in itertools.product(VIEWS, LIGHTS)} | {("none", "day"): 1}
    chosen: list[tuple[tuple[str, str], Sample]] = []
    for index in range(len(frames)):
        if not any(wanted.values()):
            break
        sample = frames[index]
        kind = (sample.view, sample.lighting)
        if wanted.get(kind, 0) and (sample.view == "none" or len(sample.lines) >= LEAST_LINES):
            wanted[kind] -= 1
            chosen.append((kind, sample))
    order = list(wanted)
    return [sample for _, sample in sorted(chosen, key=lambda pair: order.index(pair[0]))]


def compare(
    frames: Sequence[Sample], detectors: Mapping[str, LineDetector], regions: Mapping[str, FindRegions] | None = None
) -> np.ndarray:
    """One row a frame: its labels, then what each detector finds.

    Args:
        frames: to show.
        detectors: title -> detector.
        regions: title -> finder of regions, drawn beneath that detector's lines.

    Returns:
        uint8 (H, W, 3).

    Raises:
        ValueError: no frames.
    """
    if not frames:
        raise ValueError("frames is empty, a picture needs at least one")
    rows = [np.hstack([_title(text) for text in ("labels", *detectors)])]
    for frame in frames:
        bright = brightened(frame.rgb)
        tiles = [_tile(_drawn(bright, frame.lines, TRUE))]
        for title, detect in detectors.items():
            picture = bright
            if regions and title in regions:
                picture = _boxed(bright, regions[title](frame.rgb))
            tiles.append(_tile(_drawn(picture, detect(frame.rgb, frame.depth_m), FOUND)))
        rows.append(np.hstack(tiles))
    return np.vstack(rows)


def brightened(rgb: np.ndarray) -> np.ndarray:
    """A picture that can be seen: dark ones are multiplied up, at most sixfold.

    Args:
        rgb: uint8 (H, W, 3).
    """
    lit = rgb[rgb.max(axis=2) > 0]
    gain = min(max(SHOWN_MEAN / max(float(lit.mean()) if len(lit) else 0.0, 1.0), 1.0), MAX_GAIN)
    return np.clip(rgb * gain, 0.0, 255.0).astype(np.uint8)


def _drawn(rgb: np.ndarray, lines: np.ndarray, colour: Colour) -> np.ndarray:
    picture = np.ascontiguousarray(rgb).copy()
    for x1, y1, x2, y2 in np.round(np.asarray(lines).reshape(-1, 4) * 16).astype(int).tolist():
        cv2.line(picture, (x1, y1), (x2, y2), colour, 3, cv2.LINE_AA, shift=4)
    return picture


def _boxed(rgb: np.ndarray, regions: np.ndarray) -> np.ndarray:
    picture = np.ascontiguousarray(rgb).copy()
    for x1, y1, x2, y2 in np.round(regions[:, :4]).astype(int).tolist():
        cv2.rectangle(picture, (x1, y1), (x2, y2), REGION, 3)
    return picture


def _tile(picture: np.ndarray) -> np.ndarray:
    small = cv2.resize(picture, (TILE_PX, TILE_PX), interpolation=cv2.INTER_AREA)
    return np.pad(small, ((0, GAP_PX), (0, GAP_PX), (0, 0)), constant_values=PANEL[0])


def _title(text: str) -> np.ndarray:
    band = np.full((TITLE_PX, TILE_PX + GAP_PX, 3), PANEL, np.uint8)
    cv2.putText(band, text, (4, TITLE_PX - 7), FONT, 0.34, INK, 1, cv2.LINE_AA)
    return band
