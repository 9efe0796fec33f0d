"""Lines that the detector missed, from depth: a strip that shows a tread and a riser is cut where the two meet.

Inner edges are the hardest lines to see, and without them the strip from one nosing to the next holds two faces. If
its lower and its upper part are explained by one face each, the corner lies where the two planes intersect. A line is
put there only if that is inside the strip.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from perception.face_kinds import RISER, TREAD, UNKNOWN, Candidate
from perception.faces import COLUMN_BANDS, ROW_SAMPLES, Faces, Strips, explain_strips
from stair_env.camera.intrinsics import Intrinsics

MIN_THICKNESS_PX = 12.0  # of a strip worth cutting, in pixels of a 640 pixels wide image
SPLITS = (2, 3, 4, 5, 6)  # upper rows of samples against the rest
MAX_PART_COST = 3.5  # of a part, as `perception.face_kinds` counts: less than leaving it unexplained
MARGIN_PX = 3.0  # of the corner from the strip's lines
HALF_WIDTH_M = 0.3  # of the points that the new line is drawn through


def find_missing_lines(
    strips: Strips,
    faces: Faces,
    lines: np.ndarray,
    thickness_px: np.ndarray,
    intrinsics: Intrinsics,
    support: int,
) -> np.ndarray:
    """Lines where unexplained strips turn from tread to riser, or from riser to tread.

    Args:
        strips: K sampled strips.
        faces: of them.
        lines: (K - 1, 8) detected lines, nearest first, rows of `perception.lines.LINE_FIELDS`.
        thickness_px: (K,) of the strips, in pixels of a 640 pixels wide image.
        intrinsics: of the image.
        support: that the new lines claim.

    Returns:
        (v, 8) rows of `LINE_FIELDS` with score 0.
    """
    inner = np.arange(1, len(faces.kind) - 1)
    wanted = inner[(faces.kind[inner] == UNKNOWN) & (thickness_px[inner] > MIN_THICKNESS_PX)]
    best: dict[int, tuple[float, np.ndarray]] = {}
    for split in SPLITS if len(wanted) else ():
        upper = explain_strips(_part(strips, wanted, slice(0, split)), faces.camera_to_stair, split)
        rows = ROW_SAMPLES - split
        lower = explain_strips(_part(strips, wanted, slice(split, None)), faces.camera_to_stair, rows)
        for place, strip in enumerate(wanted.tolist()):
            cost, corner = _corner(place, lower, upper)
            if corner is None or cost >= best.get(strip, (np.inf, None))[0]:
                continue
            line = _line_through(corner, faces.camera_to_stair, intrinsics, lines[strip - 1], lines[strip], support)
            if line is not None:
                best[strip] = (cost, line)
    return np.array([line for _, line in best.values()]).reshape(-1, lines.shape[1])


def _part(strips: Strips, wanted: np.ndarray, rows: slice) -> Strips:
    """Some rows of the samples of some strips."""

    def cut(values: np.ndarray) -> Any:
        shaped = values[wanted].reshape(len(wanted), COLUMN_BANDS, ROW_SAMPLES, *values.shape[2:])[:, :, rows]
        return np.ascontiguousarray(shaped).reshape(len(wanted), -1, *values.shape[2:])

    return Strips(cut(strips.rays), cut(strips.depth_m), cut(strips.ok), strips.points_per_reading[wanted])


def _corner(
    place: int, lower: tuple[Candidate, Candidate], upper: tuple[Candidate, Candidate]
) -> tuple[float, tuple[float, float] | None]:
    """Cost and (forward, height) of the corner of the cheaper order of tread and riser; None if neither will do."""
    options = []
    for low_kind, high_kind in ((TREAD, RISER), (RISER, TREAD)):
        low, high = lower[low_kind - TREAD], upper[high_kind - TREAD]
        costs = float(low.cost()[place]), float(high.cost()[place])
        if max(costs) < MAX_PART_COST:
            tread, riser = (low, high) if low_kind == TREAD else (high, low)
            options.append((sum(costs), (float(riser.value[place]), float(tread.value[place]))))
    return min(options) if options else (np.inf, None)


def _line_through(
    corner: tuple[float, float],
    camera_to_stair: np.ndarray,
    intrinsics: Intrinsics,
    low: np.ndarray,
    high: np.ndarray,
    support: int,
) -> np.ndarray | None:
    """Image of the stair line at (forward, height), if it runs between two detected lines."""
    forward, height = corner
    points = np.array([[forward, HALF_WIDTH_M, height], [forward, -HALF_WIDTH_M, height]]) @ camera_to_stair
    if (points[:, 2] < 0.1).any():
        return None
    (x1, y1), (x2, y2) = intrinsics.project(points)
    if x2 - x1 < 1.0:
        return None
    k = (y2 - y1) / (x2 - x1)
    b = y1 - k * x1
    start, end = max(low[0], high[0]), min(low[2], high[2])
    if end <= start:
        start, end = low[0], low[2]
    middle = (start + end) / 2.0
    if not high[4] * middle + high[5] + MARGIN_PX < k * middle + b < low[4] * middle + low[5] - MARGIN_PX:
        return None
    return np.array([start, k * start + b, end, k * end + b, k, b, 0.0, support])
