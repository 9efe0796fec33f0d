"""The visible part of each stair edge in the image: what a person with a ruler would draw.

Edges come from the staircase's geometry, visibility from the exact depth of the same frame. Nothing is detected.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stair_env.common.validation import check_choice
from stair_env.intrinsics import Intrinsics
from stair_env.sensors.camera.renderers.base import NEAR_M, Frame, check_pose
from stair_env.stairs import EdgeKind, StairEdge

EDGE_KINDS: tuple[str, ...] = ("convex", "concave")  # in the order of the paper's class numbers

MIN_LENGTH_PX = 16.0  # half a cell of the paper's 32-column grid on a 512 px image
MIN_GAP_PX = 3.0  # lines closer than this cannot be told apart in a 512 px image
MAX_BRIDGED_PX = 24.0  # a 40 mm post is this wide 0.8 m in front of the camera
SAMPLE_SPACING_PX = 0.75
DEPTH_TOLERANCE_M = 0.006  # rounding of pixels on the two faces that meet in an edge ...
DEPTH_TOLERANCE_SLOPE = 0.006  # ... which grows with distance; a hidden inner edge lies a riser's height behind


@dataclass(frozen=True)
class LineLabel:
    """A straight stair line in an image.

    Attributes:
        kind: "convex" (class 0) or "concave" (class 1).
        x1, y1, x2, y2: end points, pixels from the top left corner of the image, left end first.
        step: the `StairEdge.step` that it shows, -1 when unknown.
    """

    kind: EdgeKind
    x1: float
    y1: float
    x2: float
    y2: float
    step: int = -1

    def __post_init__(self) -> None:
        check_choice("kind", self.kind, EDGE_KINDS)
        if not self.x1 <= self.x2:
            raise ValueError(f"x1={self.x1!r} must not be right of x2={self.x2!r}")

    @property
    def class_id(self) -> int:
        """0 for convex, 1 for concave, as in the paper's label files."""
        return EDGE_KINDS.index(self.kind)

    @property
    def length(self) -> float:
        """Pixels."""
        return math.hypot(self.x2 - self.x1, self.y2 - self.y1)


def visible_edges(
    edges: Sequence[StairEdge],
    intrinsics: Intrinsics,
    camera_to_world: np.ndarray,
    frame: Frame,
    *,
    min_length_px: float = MIN_LENGTH_PX,
    min_gap_px: float = MIN_GAP_PX,
) -> list[LineLabel]:
    """Find the longest visible part of each edge.

    Args:
        edges: stair lines in the world frame.
        intrinsics: of the frame.
        camera_to_world: (4, 4) pose of the optical frame.
        frame: drawn with these intrinsics from this pose.
        min_length_px: shorter parts are dropped.
        min_gap_px: of two lines that lie closer together one is dropped: the inner edge beside a nosing, else the
            farther one.

    Returns:
        Labels in the order of edges.

    Raises:
        ValueError: the frame's size is not the intrinsics', or the pose is not a rigid transform.
    """
    shape = (intrinsics.height, intrinsics.width)
    if frame.depth_m.shape != shape:
        raise ValueError(f"depth_m has shape {frame.depth_m.shape}, the intrinsics say {shape}")
    pose = check_pose(camera_to_world)
    seen = []
    for edge in edges:
        segment = clip_to_view((edge.endpoints - pose[:3, 3]) @ pose[:3, :3], intrinsics)
        if segment is not None:
            seen.append((edge, *_sample(segment, intrinsics)))
    if not seen:
        return []
    visible = _is_visible(
        np.concatenate([uv for _, uv, _ in seen]), np.concatenate([z for _, _, z in seen]), frame.depth_m
    )
    labels, distances, start = [], [], 0
    for edge, uv, z in seen:
        run = _longest_run(visible[start : start + len(uv)], _max_bridged_samples(uv))
        start += len(uv)
        if run is not None:
            (x1, y1), (x2, y2) = sorted(uv[[run[0], run[1] - 1]].tolist())
            labels.append(LineLabel(edge.kind, x1, y1, x2, y2, edge.step))
            distances.append(float(z[run[0] : run[1]].mean()))
    return [label for label in _drop_crowded(labels, distances, min_gap_px) if label.length >= min_length_px]


def clip_to_view(points_camera: np.ndarray, intrinsics: Intrinsics) -> np.ndarray | None:
    """The part of a segment in front of the camera and inside the image.

    Args:
        points_camera: (2, 3) end points in the camera frame, metres.
        intrinsics: of the image.

    Returns:
        (2, 3) end points, or None when nothing is inside.
    """
    x, y, z = np.asarray(points_camera, dtype=np.float64).T
    inside = np.stack(  # (5, 2) signed distances, positive inside: near, left, right, top, bottom
        [
            z - NEAR_M,
            intrinsics.fx * x + intrinsics.cx * z,
            (intrinsics.width - intrinsics.cx) * z - intrinsics.fx * x,
            intrinsics.fy * y + intrinsics.cy * z,
            (intrinsics.height - intrinsics.cy) * z - intrinsics.fy * y,
        ]
    )
    start, end = 0.0, 1.0
    for first, last in inside:
        if first < 0.0 and last < 0.0:
            return None
        if first < 0.0:
            start = max(start, first / (first - last))
        elif last < 0.0:
            end = min(end, first / (first - last))
    if start >= end:
        return None
    a, b = points_camera
    return np.stack([a + start * (b - a), a + end * (b - a)])


def _sample(segment: np.ndarray, intrinsics: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Points along a (2, 3) segment inside the view, evenly spaced in the image: (n, 2) pixels, (n,) depths."""
    ends = intrinsics.project(segment)
    count = max(2, int(np.ceil(np.linalg.norm(ends[1] - ends[0]) / SAMPLE_SPACING_PX)) + 1)
    along = np.linspace(0.0, 1.0, count)
    inverse = 1.0 / segment[:, 2]  # linear in the image
    return ends[0] + along[:, None] * (ends[1] - ends[0]), 1.0 / (inverse[0] + along * (inverse[1] - inverse[0]))


def _max_bridged_samples(uv: np.ndarray) -> int:
    """How many of (n, 2) samples a gap that is closed may have."""
    spacing = float(np.linalg.norm(uv[-1] - uv[0])) / (len(uv) - 1)
    return int(MAX_BRIDGED_PX / max(spacing, 1e-9))


def _is_visible(uv: np.ndarray, expected_m: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """(n,) bool: nothing stands in front of points at (n, 2) pixels and (n,) depths.

    Two faces meet in an edge. Seen at a grazing angle, the one that comes towards the camera is centimetres nearer
    half a pixel away, so the farthest of the 3 x 3 pixels around decides.
    """
    height, width = depth.shape
    flat = depth.ravel()
    u, v = np.floor(uv).astype(np.int64).T
    columns = [np.clip(u + du, 0, width - 1) for du in (-1, 0, 1)]
    farthest = np.zeros(len(uv))
    for dv in (-1, 0, 1):
        row_start = np.clip(v + dv, 0, height - 1) * width
        for column in columns:
            neighbour = flat[row_start + column]
            farthest = np.maximum(farthest, np.where(neighbour > 0.0, neighbour, np.inf))
    visible: np.ndarray = farthest >= expected_m - (DEPTH_TOLERANCE_M + DEPTH_TOLERANCE_SLOPE * expected_m)
    return visible


def _longest_run(visible: np.ndarray, max_gap: int) -> tuple[int, int] | None:
    """Longest run (start, stop) of True, after closing gaps that are short and narrower than what flanks them."""
    padded = np.concatenate([[False], visible, [False]])
    starts, stops = np.flatnonzero(np.diff(padded.astype(np.int8))).reshape(-1, 2).T
    runs: list[tuple[int, int]] = []
    for start, stop in zip(starts.tolist(), stops.tolist()):
        if runs:
            gap = start - runs[-1][1]
            if gap <= max_gap and gap <= min(stop - start, runs[-1][1] - runs[-1][0]):
                runs[-1] = (runs[-1][0], stop)
                continue
        runs.append((start, stop))
    return max(runs, key=lambda run: run[1] - run[0], default=None)


def _drop_crowded(labels: list[LineLabel], distances: list[float], min_gap_px: float) -> list[LineLabel]:
    """Leave out lines that no one could tell from a neighbour; see `visible_edges`. distances are in metres."""
    kept = []
    for label, distance in zip(labels, distances):
        rivals = [
            other
            for other, other_distance in zip(labels, distances)
            if (other.kind == label.kind and other_distance < distance)
            or (label.kind == "concave" and other.kind == "convex")
        ]
        if all(gap_px(label, other) >= min_gap_px for other in rivals):
            kept.append(label)
    return kept


def gap_px(first: LineLabel, second: LineLabel) -> float:
    """Distance of two lines amid the stretch where they run side by side, pixels; infinite where they do not."""
    a, b = (first, second) if first.length >= second.length else (second, first)
    length = a.length
    if length == 0.0:
        return math.hypot(a.x1 - b.x1, a.y1 - b.y1)
    along_x, along_y = (a.x2 - a.x1) / length, (a.y2 - a.y1) / length
    # The ends of b along a and across it.
    s1, t1 = _rotated(b.x1 - a.x1, b.y1 - a.y1, along_x, along_y)
    s2, t2 = _rotated(b.x2 - a.x1, b.y2 - a.y1, along_x, along_y)
    low, high = max(0.0, min(s1, s2)), min(length, max(s1, s2))
    if high <= low:
        return math.inf
    slope = (t2 - t1) / (s2 - s1)
    return abs(t1 + slope * ((low + high) / 2.0 - s1))


def _rotated(x: float, y: float, along_x: float, along_y: float) -> tuple[float, float]:
    """Coordinates of (x, y) along a unit vector and across it."""
    return x * along_x + y * along_y, y * along_x - x * along_y
