"""Pictures of a walking robot that sees: what an onlooker sees, what its camera sees, and what it measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from stair_env.observation import STAIR_FIELDS

PANEL_SIZE = (640, 480)  # width, height of each of the two pictures, pixels
CAPTION_HEIGHT = 64
LINE_HEIGHT = 26
FONT_SCALE = 0.52
BACKGROUND = (24, 26, 30)
TEXT = (235, 235, 235)
FAINT = (150, 155, 160)
GOOD = (120, 220, 130)
BAD = (240, 120, 110)
CLOSE_MM = 15.0  # a measurement within this of the truth is written in green
MM = 1000.0

Word = tuple[str, tuple[int, int, int]]


def compose(onlooker: np.ndarray, camera: np.ndarray | None, caption: Sequence[Sequence[Word]]) -> np.ndarray:
    """Two pictures side by side over a caption.

    Args:
        onlooker, camera: uint8 (H, W, 3), any size; each is fitted into its panel without distortion. Without a
            camera there is one panel.
        caption: up to two lines of coloured words.

    Returns:
        uint8 (544, 1280, 3), or (544, 640, 3) without a camera.
    """
    width, height = PANEL_SIZE
    panels = 1 if camera is None else 2
    frame = np.full((height + CAPTION_HEIGHT, panels * width, 3), BACKGROUND, np.uint8)
    frame[:height, :width] = fit(onlooker, PANEL_SIZE)
    if camera is not None:
        frame[:height, width:] = fit(camera, PANEL_SIZE)
    for row, words in enumerate(caption):
        _write(frame, words, (14, height + 26 + row * LINE_HEIGHT))
    return frame


def fit(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Scale a picture uint8 (H, W, 3) into (width, height), centred on a dark ground."""
    width, height = size
    scale = min(width / picture.shape[1], height / picture.shape[0])
    inner = (round(picture.shape[1] * scale), round(picture.shape[0] * scale))
    scaled = picture if inner == picture.shape[1::-1] else cv2.resize(picture, inner, interpolation=cv2.INTER_AREA)
    out = np.full((height, width, 3), BACKGROUND, np.uint8)
    top, left = (height - inner[1]) // 2, (width - inner[0]) // 2
    out[top : top + inner[1], left : left + inner[0]] = scaled
    return out


def _write(frame: np.ndarray, words: Sequence[Word], origin: tuple[int, int]) -> None:
    x, y = origin
    for text, colour in words:
        cv2.putText(frame, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, FONT_SCALE, colour, 1, cv2.LINE_AA)
        x += cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, FONT_SCALE, 1)[0][0] + 8


def measurement_words(block: np.ndarray, truth: Mapping[str, float]) -> list[Word]:
    """What the robot believes beside what is true, in millimetres.

    Args:
        block: (8,) stair block of the observation.
        truth: `info["truth"]`.
    """
    seen = dict(zip(STAIR_FIELDS, np.asarray(block, float)))
    if seen["valid"] < 0.5:
        return [("no stairs ahead" if truth["valid"] < 0.5 else "stairs not seen", FAINT)]
    words: list[Word] = [("up" if seen["direction"] > 0 else "down", TEXT)]
    for name, field in (("width", "step_width"), ("height", "step_height"), ("next edge", "edge_distance")):
        words.append((name, FAINT))
        error = (seen[field] - truth[field]) * MM
        known = truth["valid"] > 0.5
        colour = (GOOD if abs(error) <= CLOSE_MM else BAD) if known else TEXT
        words.append((f"{seen[field] * MM:.0f}", colour))
        words.append((f"(true {truth[field] * MM:.0f}) mm" if known else "mm", FAINT))
    return words
