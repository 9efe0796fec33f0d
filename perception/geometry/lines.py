"""From the network's two tensors to straight lines in the image.

The network answers per cell of a 32 x 16 grid over the 512 x 512 letterboxed image; a stair line crosses many cells.
Clustering follows the paper ("Stair line clustering"): lines are started by least squares in the middle two columns,
the remaining columns are taken from the middle to both sides, each segment joins the line it lies on or starts a new
one, slope and intercept are recalculated, and the whole assignment is repeated until it no longer changes.

Arrays hold lines as rows of `LINE_FIELDS`; `StairLine` is the same as an object for whoever reads one line.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stair_env.common.constants import CELL_HEIGHT_PX, CELL_WIDTH_PX, GRID_COLUMNS, GRID_ROWS, IMAGE_SIZE
from stair_env.intrinsics import letterbox_padding

SCORE_THRESHOLD = 0.5  # the paper's confidence

SAME_LINE_PX = 3.0  # two predictions of a cell closer than this are one line; about three times the detector's jitter
TWIN_PX = 2.5  # lines that stay closer than this are one; labels keep 3 px between lines
MAX_SLOPE = 3.0  # steeper than any stair line that a camera within 60 degrees of roll can see
SHORT_SEGMENT_PX = 8.0  # a segment this short says half of what its neighbours say about its slope

LINE_FIELDS = ("x1", "y1", "x2", "y2", "k", "b", "score", "support")


def median(values: np.ndarray) -> float:
    """Median of (n,) finite values, n > 0: `np.median` takes five times as long for a few dozen numbers."""
    ordered, middle = np.sort(values), len(values) // 2
    return float(ordered[middle] if len(values) % 2 else 0.5 * (ordered[middle - 1] + ordered[middle]))


class LineSlopes(NamedTuple):
    """How the camera sees the lines.

    Attributes:
        slope, std: (m,) height per forward metre at which each line is seen, and its standard deviation.
        confirmed: (m,) whether detector and depth agree on the line.
    """

    slope: np.ndarray
    std: np.ndarray
    confirmed: np.ndarray


@dataclass(frozen=True)
class StairLine:
    """One stair line, the paper's six-tuple with what it rests on.

    Attributes:
        x1, y1, x2, y2: left and right end point, pixels.
        k, b: slope and intercept of y = k x + b, pixels.
        score: mean class score of its cells, 0..1.
        support: number of cell predictions that lie on it.
        kind: "convex", "concave" or "unknown"; the network does not tell them apart, geometry does.
    """

    x1: float
    y1: float
    x2: float
    y2: float
    k: float
    b: float
    score: float
    support: int
    kind: str = "unknown"


@dataclass(frozen=True)
class Segments:
    """What the grid says before clustering, n predictions.

    Attributes:
        ends: (n, 4) float64 x1, y1, x2, y2 in pixels of the 512 x 512 image, left end first.
        column: (n,) grid column.
        score: (n,) class score of the cell.
    """

    ends: np.ndarray
    column: np.ndarray
    score: np.ndarray

    def __len__(self) -> int:
        return len(self.score)


def decode_cells(cls: np.ndarray, loc: np.ndarray, threshold: float = SCORE_THRESHOLD) -> Segments:
    """Line segments of the cells that hold a stair line.

    Args:
        cls: (32, 16) class scores, 0..1.
        loc: (32, 16, 8) coordinates within the cell, 0..1, two lines a cell.
        threshold: lowest score of a cell that counts.

    Returns:
        Segments; a second prediction that nearly equals the first of its cell is left out, and so is a prediction
        that is not finite.

    Raises:
        ValueError: an array has another shape.
    """
    cls, loc = np.asarray(cls, dtype=np.float64), np.asarray(loc, dtype=np.float64)
    if cls.shape != (GRID_ROWS, GRID_COLUMNS):
        raise ValueError(f"cls has shape {cls.shape}, must be {(GRID_ROWS, GRID_COLUMNS)}")
    if loc.shape != (GRID_ROWS, GRID_COLUMNS, 8):
        raise ValueError(f"loc has shape {loc.shape}, must be {(GRID_ROWS, GRID_COLUMNS, 8)}")
    row, column = np.nonzero(cls >= threshold)
    ends = cell_ends(np.clip(loc[row, column], 0.0, 1.0), row, column)
    swapped = ends[..., 0, 0] > ends[..., 1, 0]
    ends[swapped] = ends[swapped][:, ::-1]
    ends = ends.reshape(-1, 2, 4)

    # NaN compares false, so a second prediction without numbers is no new line either.
    new_second = np.abs(_height_above(ends[:, 0], ends[:, 1])) > SAME_LINE_PX
    chosen = np.stack([np.ones_like(new_second), new_second], axis=1) & np.isfinite(ends).all(axis=2)
    cell, _ = np.nonzero(chosen)
    return Segments(ends[chosen], column[cell], cls[row, column][cell])


def cell_ends(loc: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Coordinates within cells as pixels of the 512 x 512 image.

    Args:
        loc: (n, 8) float64, two lines a cell, 0..1.
        row, column: (n,) of the cells.

    Returns:
        (n, 2, 2, 2) cells, lines, ends, x and y.
    """
    corner = np.stack([column, row], axis=-1)[:, None, None, :]
    pixels: np.ndarray = (loc.reshape(-1, 2, 2, 2) + corner) * (CELL_WIDTH_PX, CELL_HEIGHT_PX)
    return pixels


def _height_above(ends: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(n,) vertical distance of the middle of `other` from the line through `ends`, both (n, 4), pixels."""
    dx, dy = ends[:, 2] - ends[:, 0], ends[:, 3] - ends[:, 1]
    slope = np.clip(dx * dy / (dx * dx + 1.0), -MAX_SLOPE, MAX_SLOPE)
    middle, other_middle = _middles(ends), _middles(other)
    return other_middle[:, 1] - middle[:, 1] - slope * (other_middle[:, 0] - middle[:, 0])


def _middles(ends: np.ndarray) -> np.ndarray:
    return (ends[:, :2] + ends[:, 2:]) / 2.0


def cluster_segments(segments: Segments) -> np.ndarray:
    """Group segments into lines from the middle two columns outwards, iterated.

    Args:
        segments: as `decode_cells` returns them.

    Returns:
        (m, 8) float64 rows of `LINE_FIELDS`, pixels of the 512 x 512 image, from the top of the image to its bottom.
    """
    if len(segments) == 0:
        return np.empty((0, len(LINE_FIELDS)))
    from perception.geometry import line_kernels

    ends = np.ascontiguousarray(segments.ends)
    dx, dy = ends[:, 2] - ends[:, 0], ends[:, 3] - ends[:, 1]
    long = dx > SHORT_SEGMENT_PX
    common = min(max(median(dy[long] / dx[long]), -MAX_SLOPE), MAX_SLOPE) if long.any() else 0.0
    prior = SHORT_SEGMENT_PX**2
    slope = np.clip((dx * dy + prior * common) / (dx * dx + prior), -MAX_SLOPE, MAX_SLOPE)
    label, fitted = np.empty(len(segments), dtype=np.int64), np.empty((len(segments), 4))
    score = np.ascontiguousarray(segments.score, dtype=np.float64)
    count = line_kernels.cluster(ends, np.asarray(segments.column), score, slope, common, label, fitted)
    return _merge_twins(_as_rows(fitted[:count], label, score))


def _as_rows(fitted: np.ndarray, label: np.ndarray, score: np.ndarray) -> np.ndarray:
    """Rows of `LINE_FIELDS`, top to bottom, from (m, 4) k, b, least x, greatest x."""
    k, b, x1, x2 = fitted.T
    support = np.bincount(label, minlength=len(k)).astype(np.float64)
    mean_score = np.bincount(label, score, len(k)) / support
    rows = np.stack([x1, k * x1 + b, x2, k * x2 + b, k, b, mean_score, support], axis=1)
    return rows[np.argsort(rows[:, 1] + rows[:, 3])]


def _merge_twins(rows: np.ndarray) -> np.ndarray:
    """Join lines that stay within the twin distance of each other where both are seen, or across their gap."""
    while True:
        twins = np.argwhere(np.triu(_are_twins(rows), k=1))
        if len(twins) == 0:
            return rows
        gone: set[int] = set()
        for first, second in twins.tolist():
            if first not in gone and second not in gone:
                rows[first] = _join(rows[first], rows[second])
                gone.add(second)
        rows = np.delete(rows, sorted(gone), axis=0)


def _are_twins(rows: np.ndarray) -> np.ndarray:
    """(m, m) bool."""
    low, high = np.maximum(rows[:, None, 0], rows[None, :, 0]), np.minimum(rows[:, None, 2], rows[None, :, 2])
    slope, offset = rows[:, None, 4] - rows[None, :, 4], rows[:, None, 5] - rows[None, :, 5]
    return (np.abs(slope * low + offset) <= TWIN_PX) & (np.abs(slope * high + offset) <= TWIN_PX)


def _join(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """One line from two, each standing for points spread evenly between its ends."""
    points_x = np.concatenate([np.linspace(line[0], line[2], 8) for line in (a, b)])
    points_y = np.concatenate([line[4] * np.linspace(line[0], line[2], 8) + line[5] for line in (a, b)])
    weight = np.repeat([a[7], b[7]], 8)
    mean_x, mean_y = np.average(points_x, weights=weight), np.average(points_y, weights=weight)
    dx, dy = points_x - mean_x, points_y - mean_y
    k = float((weight * dx * dy).sum() / max((weight * dx * dx).sum(), 1e-9)) if np.ptp(points_x) > 1.0 else a[4]
    k = float(np.clip(k, -MAX_SLOPE, MAX_SLOPE))
    offset = float(mean_y - k * mean_x)
    x1, x2, support = min(a[0], b[0]), max(a[2], b[2]), a[7] + b[7]
    score = (a[6] * a[7] + b[6] * b[7]) / support
    return np.array([x1, k * x1 + offset, x2, k * x2 + offset, k, offset, score, support])


def find_lines(cls: np.ndarray, loc: np.ndarray, threshold: float = SCORE_THRESHOLD) -> np.ndarray:
    """Decode and cluster: (m, 8) rows of `LINE_FIELDS` in pixels of the 512 x 512 image, top to bottom.

    Args:
        cls: (32, 16) class scores, 0..1.
        loc: (32, 16, 8) coordinates within the cell, 0..1.
        threshold: lowest score of a cell that counts.

    Raises:
        ValueError: an array has another shape.
    """
    return cluster_segments(decode_cells(cls, loc, threshold))


def to_image_pixels(lines: np.ndarray, width: int, height: int) -> np.ndarray:
    """Undo the letterbox: lines in pixels of the width x height image that was padded and scaled to 512 x 512.

    Args:
        lines: (m, 8) rows of `LINE_FIELDS` in pixels of the 512 x 512 image.
        width, height: size of the original image, pixels.

    Returns:
        (m, 8) float64; lines in the padding, outside the image, are left out.
    """
    left, top, side = letterbox_padding(width, height)
    scale = side / IMAGE_SIZE
    moved = np.array(lines, dtype=np.float64)
    moved[:, [0, 2]] = lines[:, [0, 2]] * scale - left
    moved[:, 5] = lines[:, 5] * scale - top + lines[:, 4] * left
    moved[:, [0, 2]] = np.clip(moved[:, [0, 2]], 0.0, width)
    moved[:, 1] = moved[:, 4] * moved[:, 0] + moved[:, 5]
    moved[:, 3] = moved[:, 4] * moved[:, 2] + moved[:, 5]
    middle_y = (moved[:, 1] + moved[:, 3]) / 2.0
    inside = (moved[:, 2] > moved[:, 0]) & (middle_y >= 0.0) & (middle_y <= height)
    return moved[inside]


def as_stair_lines(lines: np.ndarray, kinds: tuple[str, ...] | None = None) -> tuple[StairLine, ...]:
    """Rows of `LINE_FIELDS` as objects; kinds, if given, one per row."""
    names = kinds if kinds is not None else ("unknown",) * len(lines)
    return tuple(
        StairLine(x1, y1, x2, y2, k, b, score, int(support), name)
        for (x1, y1, x2, y2, k, b, score, support), name in zip(lines.tolist(), names)
    )
