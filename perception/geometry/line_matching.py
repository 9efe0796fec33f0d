"""The detector's lines against the cross-section that depth shows: missing ones added, false ones left out.

A detector misses lines, inner edges before all, and finds only pieces of others. Depth shows the corners of a
staircase well, but it needs the lines to know where the staircase is and which way it runs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from perception.geometry.lines import SCORE_THRESHOLD, median
from perception.geometry.profile.depth_profile import Profile, ProfileEdge, read_profile
from stair_env.common.constants import MEASURABLE_RISER_M, MEASURABLE_TREAD_M
from stair_env.intrinsics import Intrinsics

IMAGE_WIDTH_PX = 640.0  # of the image for which pixels are given below
MATCH_PX = 6.0  # of a detected line from an edge of the cross-section: two of its rows and three jitters
SAMPLES = 9  # along a line, to see how far away it is
SAMPLE_OFFSET_PX = 4.0  # above and below the line, clear of flying pixels
EXTENT_SHARE = 0.2  # of the lines' weight that may lie outside the staircase's width: lines on walls and floors
PIECE_STD_PX = 2.0  # of a cell's prediction, as far as its errors are its own
WIDEST_M = 5.0  # to either side of the camera, when the extent is unknown
SLOPE_STD = 0.01  # of lines drawn after the others' direction, as the yaw from a few lines has it


@dataclass(frozen=True)
class CheckedLines:
    """Lines that depth agrees with, nearest first.

    Attributes:
        lines: (n, 8) rows of `perception.geometry.lines.LINE_FIELDS`; those that only depth shows have score 0.
        source: (n,) row of the detected line each one comes from, -1 for none.
        own_length: (n,) pixels over which the detector saw it, 0 where it did not.
        confirmed: (n,) whether both the detector and depth show it.
        profile: the cross-section.
    """

    lines: np.ndarray
    source: np.ndarray
    own_length: np.ndarray
    confirmed: np.ndarray
    profile: Profile


def check_lines(
    lines: np.ndarray,
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
    camera_to_stair: np.ndarray,
    omega_m: float,
    support: int,
) -> CheckedLines:
    """Compare detected lines with the cross-section of what depth shows where they are.

    Args:
        lines: (m, 8) rows of `perception.geometry.lines.LINE_FIELDS`, pixels of the depth image, m > 0.
        depth_m: (H, W) float, metres, 0 = no reading.
        intrinsics: of the depth image.
        camera_to_stair: (3, 3) rotation into (f, l, h).
        omega_m: faces of one kind nearer than this are one.
        support: that added lines claim.
    """
    lateral = lateral_extent(lines, depth_m, intrinsics, camera_to_stair)
    middle_x = median((lines[:, 0] + lines[:, 2]) / 2.0)
    profile = read_profile(depth_m, intrinsics, camera_to_stair, middle_x, lateral, omega_m)
    drawn = _draw_edges(profile, lateral, camera_to_stair, intrinsics, support)
    match_px = MATCH_PX * intrinsics.width / IMAGE_WIDTH_PX
    match = _match(lines, drawn, match_px)
    connected = _connected(profile.edges, np.isin(np.arange(len(drawn)), match))
    kept, source, confirmed = [], [], []
    for edge, row in enumerate(drawn):
        if np.isnan(row[4]) or not connected[edge]:
            continue
        taken = np.nonzero(match == edge)[0]
        if len(taken):
            kept.append(_join(lines[taken], row))
            source.append(int(taken[np.argmax(lines[taken, 7])]))
        else:
            kept.append(row)
            source.append(-1)
        confirmed.append(len(taken) > 0)
    for index in np.nonzero((match < 0) & (lines[:, 6] >= SCORE_THRESHOLD))[0].tolist():
        if not _inside_a_face(lines[index], profile, camera_to_stair, intrinsics, match_px):
            kept.append(lines[index])
            source.append(index)
            confirmed.append(False)
    found = np.array(kept).reshape(-1, lines.shape[1])
    order = np.argsort(-(found[:, 4] * middle_x + found[:, 5]), kind="stable")
    origin = np.array(source, dtype=int)[order]
    own_length = np.where(origin >= 0, (lines[:, 2] - lines[:, 0])[origin], 0.0)
    return CheckedLines(found[order], origin, own_length, np.array(confirmed, dtype=bool)[order], profile)


def lateral_extent(
    lines: np.ndarray, depth_m: np.ndarray, intrinsics: Intrinsics, camera_to_stair: np.ndarray
) -> tuple[float, float]:
    """Least and greatest l, metres, between which most of the lines run; everything when depth cannot tell.

    Args:
        lines: (m, 8) as above.
        depth_m: (H, W).
        intrinsics: of it.
        camera_to_stair: (3, 3).
    """

    from perception.geometry.profile import depth_profile_kernels

    kernels: Any = depth_profile_kernels
    distance = np.empty(len(lines))
    kernels.line_distances(
        np.ascontiguousarray(lines),
        depth_m,
        intrinsics.fx,
        intrinsics.fy,
        intrinsics.cx,
        intrinsics.cy,
        np.ascontiguousarray(camera_to_stair[0]),
        SAMPLES,
        SAMPLE_OFFSET_PX * intrinsics.width / IMAGE_WIDTH_PX,
        distance,
    )
    seen = distance > 0.0
    if not seen.any():
        return -np.inf, np.inf
    ends = lines[seen][:, :4].reshape(-1, 2, 2)
    end_rays = np.stack(
        [(ends[..., 0] - intrinsics.cx) / intrinsics.fx, (ends[..., 1] - intrinsics.cy) / intrinsics.fy], axis=-1
    )
    to = camera_to_stair[:2]
    ahead = end_rays @ to[0, :2] + to[0, 2]
    lateral = distance[seen, None] * (end_rays @ to[1, :2] + to[1, 2]) / np.maximum(ahead, 1e-3)  # (n, left and right)
    weight = lines[seen, 7]
    return _weighted_quantile(lateral[:, 1], weight, EXTENT_SHARE), _weighted_quantile(
        lateral[:, 0], weight, 1.0 - EXTENT_SHARE
    )


def _weighted_quantile(values: np.ndarray, weight: np.ndarray, share: float) -> float:
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order][min(np.searchsorted(total, share * total[-1]), len(values) - 1)])


def _draw_edges(
    profile: Profile, lateral: tuple[float, float], camera_to_stair: np.ndarray, intrinsics: Intrinsics, support: int
) -> np.ndarray:
    """(e, 8) image lines of the cross-section's edges over the staircase's width; NaN where one is not in the image."""
    rows = np.full((len(profile.edges), 8), np.nan)
    low, high = max(lateral[0], -WIDEST_M), min(lateral[1], WIDEST_M)
    for index, edge in enumerate(profile.edges):
        ends = np.array([[edge.forward_m, high, edge.height_m], [edge.forward_m, low, edge.height_m]]) @ camera_to_stair
        if (ends[:, 2] < 0.1).any():
            continue
        (x1, y1), (x2, y2) = intrinsics.project(ends)
        if x2 - x1 < 1.0:
            continue
        k = (y2 - y1) / (x2 - x1)
        b = y1 - k * x1
        x1, x2 = max(x1, 0.0), min(x2, float(intrinsics.width))
        if x2 - x1 >= 1.0:
            rows[index] = (x1, k * x1 + b, x2, k * x2 + b, k, b, 0.0, support)
    return rows


def _connected(edges: tuple[ProfileEdge, ...], confirmed: np.ndarray) -> np.ndarray:
    """(e,) whether an edge is confirmed by a line, or hangs together with such a one step by step."""
    connected = confirmed.copy()
    for order in (range(1, len(edges)), range(len(edges) - 2, -1, -1)):
        for index in order:
            edge, other = edges[index], edges[index - order.step]
            apart = abs(edge.forward_m - other.forward_m), abs(edge.height_m - other.height_m)
            if connected[index - order.step] and apart[0] < MEASURABLE_TREAD_M and apart[1] < MEASURABLE_RISER_M:
                connected[index] = True
    return connected


def _match(lines: np.ndarray, drawn: np.ndarray, match_px: float) -> np.ndarray:
    """(m,) the edge that each line shows from end to end, -1 for none."""
    if len(drawn) == 0:
        return np.full(len(lines), -1)
    slope, offset = lines[:, 4] - drawn[:, 4:5], lines[:, 5] - drawn[:, 5:6]  # (e, m)
    miss = 0.5 * (np.abs(slope * lines[:, 0] + offset) + np.abs(slope * lines[:, 2] + offset))
    miss = np.where(np.isnan(miss), np.inf, miss)
    nearest = np.argmin(miss, axis=0)
    return np.where(miss[nearest, np.arange(len(lines))] < match_px, nearest, -1)


def _join(pieces: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """One line over the whole width of the staircase from the (p, 8) pieces of it that were detected.

    Where it lies is what the pieces say; how it runs is the mean of that, which short lines know badly, and of how the
    other edges of the staircase run.
    """
    weight = np.repeat(pieces[:, 7], 2)
    x = pieces[:, [0, 2]].ravel()
    off = pieces[:, [1, 3]].ravel() - edge[4] * x - edge[5]
    total = float(weight.sum())
    middle, mean = float(weight @ x) / total, float(weight @ off) / total
    spread = float((weight * (x - middle) ** 2).sum())
    k = float((weight * (x - middle) * (off - mean)).sum()) / (spread + (PIECE_STD_PX / SLOPE_STD) ** 2)
    k, b = edge[4] + k, edge[5] + mean - k * middle
    x1, x2, support = min(x.min(), edge[0]), max(x.max(), edge[2]), pieces[:, 7].sum()
    score = float(pieces[:, 6] @ pieces[:, 7]) / support
    return np.array([x1, k * x1 + b, x2, k * x2 + b, k, b, score, support])


def _inside_a_face(
    line: np.ndarray, profile: Profile, camera_to_stair: np.ndarray, intrinsics: Intrinsics, match_px: float
) -> bool:
    """Whether depth shows one and the same face above and below a line."""
    x = (line[0] + line[2]) / 2.0
    y = line[4] * x + line[5] + np.array([match_px, 0.0, -match_px])
    rays = np.stack([np.full(3, (x - intrinsics.cx) / intrinsics.fx), (y - intrinsics.cy) / intrinsics.fy, np.ones(3)])
    forward, _, up = camera_to_stair @ rays
    rows = np.searchsorted(profile.slope, up / np.maximum(forward, 1e-3))
    faces = profile.face[np.clip(rows, 0, len(profile.face) - 1)] if len(profile.face) else np.full(3, -1)
    return bool(faces[0] >= 0 and (faces == faces[0]).all())
