"""Where a tread ends, seen from above: the jump in depth behind a descending nosing.

Going down, only nosings are seen, and each hides a part of the next tread. Depth then jumps from one known tread to
another known tread, so that every pixel near the detected line can be said to belong to the one or the other. The row
where the one gives way to the other, over all columns together, is the nosing. It is as sharp as the detector's line,
errs independently of it, and does not move when the detector is off by some pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.geometry.strips.strip_planes import DEPTH_FLOOR_M, MAX_DEPTH_M, MIN_DEPTH_M, depth_std
from stair_env.intrinsics import Intrinsics

COLUMNS = 27
OFFSETS = 41
REACH_PX = 10.0  # beyond the detected lines, in pixels of a 640 pixels wide image
REACH_IMAGE_WIDTH_PX = 640.0
CLIP = 3.0  # standard deviations beyond which a pixel is as wrong as it can be
MIN_AGREEMENT = 0.55  # share of the evidence that one jump explains
MIN_EVIDENCE = 60.0  # summed standard deviations: a few dozen clear pixels


@dataclass(frozen=True)
class Drops:
    """Where n treads end.

    Attributes:
        offset_px: (n,) rows from the lower detected line up to the nosing, pixels (down is negative).
        found: (n,) whether depth shows the jump.
    """

    offset_px: np.ndarray
    found: np.ndarray


def locate_drops(
    low: np.ndarray,
    high: np.ndarray,
    near_height_m: np.ndarray,
    far_height_m: np.ndarray,
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
    camera_to_stair: np.ndarray,
) -> Drops:
    """Find the jump from the near to the far tread around detected lines.

    Args:
        low, high: (n, 8) the lowest and the highest line (rows of `perception.geometry.lines.LINE_FIELDS`, pixels of
            the depth image) between which the nosing is expected; often the same.
        near_height_m: (n,) height of the tread that ends, relative to the camera, metres.
        far_height_m: (n,) height of the next tread; NaN when nothing is known of it, so that only the end of the
            near tread counts.
        depth_m: (H, W) metres, 0 = no reading.
        intrinsics: of the depth image.
        camera_to_stair: (3, 3) rotation into (f, l, h).
    """
    reach = REACH_PX * intrinsics.width / REACH_IMAGE_WIDTH_PX
    start, end = np.maximum(low[:, 0], high[:, 0]), np.minimum(low[:, 2], high[:, 2])
    apart = end - start < COLUMNS
    start, end = np.where(apart, low[:, 0], start), np.where(apart, low[:, 2], end)
    x = start[:, None] + (end - start)[:, None] * (np.arange(COLUMNS) + 0.5) / COLUMNS  # (n, C)
    base = low[:, 4:5] * x + low[:, 5:6]
    span = np.abs(base - (high[:, 4:5] * x + high[:, 5:6])).mean(axis=1) + 2.0 * reach
    up = span[:, None] * np.arange(OFFSETS) / (OFFSETS - 1) - reach  # (n, D) rows above the lower line
    evidence = _evidence(
        x, base[:, :, None] - up[:, None, :], near_height_m, far_height_m, depth_m, intrinsics, camera_to_stair
    )

    # For a nosing before sample j: everything below it is the near tread, everything from j on the far one.
    along = evidence.sum(axis=1)  # (n, D)
    below = np.concatenate([np.zeros((len(along), 1)), np.cumsum(along, axis=1)], axis=1)
    score = 2.0 * below - below[:, -1:]
    peak = np.argmax(score[:, 1:-1], axis=1) + 1
    rows = np.arange(len(along))
    left, top, right = score[rows, peak - 1], score[rows, peak], score[rows, peak + 1]
    bend = left - 2.0 * top + right
    shift = np.where(bend < 0.0, 0.5 * (left - right) / np.minimum(bend, -1e-9), 0.0)
    step = span / (OFFSETS - 1)
    total = np.abs(evidence).sum(axis=(1, 2))
    found = (top > MIN_AGREEMENT * total) & (total > MIN_EVIDENCE) & (peak > 1) & (peak < OFFSETS - 1)
    return Drops((peak + np.clip(shift, -0.5, 0.5) - 0.5) * step - reach, found)


def _evidence(
    x: np.ndarray,
    y: np.ndarray,
    near_height_m: np.ndarray,
    far_height_m: np.ndarray,
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
    camera_to_stair: np.ndarray,
) -> np.ndarray:
    """(n, C, D) how much better a pixel fits the near tread than the far one, standard deviations, clipped."""
    rows, columns = depth_m.shape
    u = np.broadcast_to(x[:, :, None], y.shape).astype(np.int32)
    v = np.floor(y).astype(np.int32)
    inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
    u, v = np.clip(u, 0, columns - 1), np.clip(v, 0, rows - 1)
    depth = depth_m[v, u].astype(np.float64)
    usable = inside & (depth > MIN_DEPTH_M) & (depth < MAX_DEPTH_M)
    ray_x, ray_y = (u + 0.5 - intrinsics.cx) / intrinsics.fx, (v + 0.5 - intrinsics.cy) / intrinsics.fy
    turn = camera_to_stair[2]
    rise = np.minimum(turn[0] * ray_x + turn[1] * ray_y + turn[2], -1e-3)
    sigma = np.hypot(depth_std(depth), DEPTH_FLOOR_M)
    near_miss = np.abs(depth - near_height_m[:, None, None] / rise) / sigma
    far_miss = np.abs(depth - far_height_m[:, None, None] / rise) / sigma
    far_miss = np.where(np.isnan(far_miss), CLIP / 2.0, far_miss)
    return np.where(usable, np.minimum(far_miss, CLIP) - np.minimum(near_miss, CLIP), 0.0)
