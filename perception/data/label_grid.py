"""Stair lines in pixels, and the grid that the network is taught with.

A cell of the 32 x 16 grid is 16 pixels high and 32 wide (of a 512 x 512 image). It holds up to two line segments,
each as (x_left, y_left, x_right, y_right) within the cell, 0..1. A cell with one line holds it twice (paper, network
architecture). Label files have one line `cls x1 y1 x2 y2` a stair line.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from perception.geometry.lines import cell_ends
from stair_env.common.constants import CELL_HEIGHT_PX, CELL_WIDTH_PX, GRID_COLUMNS, GRID_ROWS, IMAGE_SIZE

CONVEX = 0  # class of a nosing in label files
CONCAVE = 1  # class of an inner edge
MIN_SEGMENT = 0.125  # of a cell: a shorter piece in a corner gives the cell no line of its own


class LabelError(ValueError):
    """A label file holds something that is no label; the message names file and line."""


@dataclass(frozen=True)
class LabelGrid:
    """Targets of one image.

    Attributes:
        cls: (32, 16) float32, 1 where the cell holds a line.
        loc: (32, 16, 8) float32 in 0..1, x1 y1 x2 y2 x3 y3 x4 y4; 0 in empty cells.
    """

    cls: np.ndarray
    loc: np.ndarray


def order_left_first(lines: np.ndarray) -> np.ndarray:
    """Swap end points so that x1 <= x2 (for x1 = x2: the upper one first).

    Args:
        lines: (n, 4) x1 y1 x2 y2.
    """
    lines = np.asarray(lines, dtype=np.float64).reshape(-1, 4)
    swap = (lines[:, 0] > lines[:, 2]) | ((lines[:, 0] == lines[:, 2]) & (lines[:, 1] > lines[:, 3]))
    return np.where(swap[:, None], lines[:, [2, 3, 0, 1]], lines)


def encode_grid(
    lines: np.ndarray,
    min_segment: float = MIN_SEGMENT,
    *,
    rows: int = GRID_ROWS,
    columns: int = GRID_COLUMNS,
) -> LabelGrid:
    """Cut lines into the grid's cells.

    Args:
        lines: (n, 4) float, pixels of the 512 x 512 image, any end first; parts outside the image are cut off.
        min_segment: pieces whose extent within the cell is shorter than this (in cell units, the larger of the two
            axes) are left out, so that a line that only nicks a corner does not claim the cell.
        rows, columns: size of the grid, for images smaller than 512 pixels; cells stay 32 x 16 pixels.

    Returns:
        The grid. Where more than two lines cross a cell the two longest pieces stay; of two lines the upper one
        (smaller mean y) comes first.
    """
    segments: dict[tuple[int, int], list[np.ndarray]] = {}
    for line in order_left_first(lines):
        for row, column, piece in _cut(line, rows, columns):
            if np.abs(piece[2:] - piece[:2]).max() >= min_segment:
                segments.setdefault((row, column), []).append(piece)
    cls = np.zeros((rows, columns), dtype=np.float32)
    loc = np.zeros((rows, columns, 8), dtype=np.float32)
    for cell, pieces in segments.items():
        longest = sorted(pieces, key=lambda p: -float(np.hypot(*(p[2:] - p[:2]))))[:2]
        first, *rest = sorted(longest, key=lambda p: (p[1] + p[3], p[0] + p[2]))
        cls[cell] = 1.0
        loc[cell] = np.concatenate([first, rest[0] if rest else first])
    return LabelGrid(cls, loc)


def _cut(line: np.ndarray, rows: int, columns: int) -> list[tuple[int, int, np.ndarray]]:
    """(row, column, piece (4,) within the cell) for each cell that a line (4,) in pixels passes."""
    scale = np.array([CELL_WIDTH_PX, CELL_HEIGHT_PX])
    start, end = line[:2] / scale, line[2:] / scale
    if not np.isfinite(line).all() or np.array_equal(start, end):
        return []
    step = end - start
    cuts = [0.0, 1.0]
    for axis in range(2):
        if step[axis] != 0.0:
            low, high = sorted((start[axis], end[axis]))
            whole = np.arange(np.ceil(max(low, 0.0)), np.floor(min(high, max(rows, columns))) + 1)
            cuts.extend((whole - start[axis]) / step[axis])
    t = np.unique(np.clip(cuts, 0.0, 1.0))
    found = []
    for t0, t1 in itertools.pairwise(t):
        column, row = np.floor(start + step * (t0 + t1) / 2).astype(int)
        if 0 <= row < rows and 0 <= column < columns:
            corner = np.array([column, row])
            piece = np.concatenate([start + step * t0 - corner, start + step * t1 - corner])
            found.append((int(row), int(column), np.clip(piece, 0.0, 1.0)))
    return found


def decode_grid(cls: np.ndarray, loc: np.ndarray, threshold: float = 0.5) -> np.ndarray:
    """Line segments of one image.

    Args:
        cls: (32, 16) probability that the cell holds a line.
        loc: (32, 16, 8) coordinates within the cell.
        threshold: least probability.

    Returns:
        (n, 2, 4) float64 pixels of the 512 x 512 image: per scored cell, in row-major order, its two segments
        x1 y1 x2 y2, which are equal where the cell holds one line.
    """
    rows, columns = np.nonzero(np.asarray(cls) >= threshold)
    return cell_ends(np.asarray(loc, dtype=np.float64)[rows, columns], rows, columns).reshape(-1, 2, 4)


def read_label_file(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Stair lines of a label file; an empty file holds none.

    Args:
        path: text file, `cls x1 y1 x2 y2` a line, cls 0 or 1, pixels of the 512 x 512 image. Blank lines are skipped.

    Returns:
        kinds: (n,) int64; lines: (n, 4) float64, left end first.

    Raises:
        LabelError: a line is malformed, or the file cannot be read; names file and line number.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise LabelError(f"{path}: cannot be read: {error}") from error
    kinds, lines = [], []
    for number, row in enumerate(text.splitlines(), start=1):
        if row.strip():
            kind, line = _parse_label(row, f"{path}:{number}")
            kinds.append(kind)
            lines.append(line)
    return np.array(kinds, dtype=np.int64), order_left_first(np.array(lines, dtype=np.float64))


def _parse_label(row: str, where: str) -> tuple[int, list[float]]:
    words = row.split()
    if len(words) != 5:
        raise LabelError(f"{where}: {row.strip()!r} has {len(words)} values, a label is `cls x1 y1 x2 y2`")
    try:
        kind, line = float(words[0]), [float(word) for word in words[1:]]
    except ValueError:
        raise LabelError(f"{where}: {row.strip()!r} holds something that is no number") from None
    if kind not in (CONVEX, CONCAVE):
        raise LabelError(f"{where}: class {words[0]} must be {CONVEX} (convex) or {CONCAVE} (concave)")
    if not np.isfinite(line).all() or not all(-1.0 <= value <= IMAGE_SIZE + 1.0 for value in line):
        raise LabelError(f"{where}: coordinates {' '.join(words[1:])} must lie in 0..{IMAGE_SIZE} pixels")
    return int(kind), line


def format_labels(kinds: np.ndarray, lines: np.ndarray) -> str:
    """The text of a label file; `read_label_file` gives kinds and lines back to 0.01 pixels."""
    ordered = order_left_first(lines)
    rows = (f"{int(k)} {x1:.2f} {y1:.2f} {x2:.2f} {y2:.2f}\n" for k, (x1, y1, x2, y2) in zip(kinds, ordered))
    return "".join(rows)
