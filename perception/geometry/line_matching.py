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
from perception.geometry.strips.strip_labels import RISER, UNKNOWN
from stair_env.common.constants import MEASURABLE_RISER_M, MEASURABLE_TREAD_M
from stair_env.intrinsics import Intrinsics

IMAGE_WIDTH_PX = 640.0  # of the image for which pixels are given below
MATCH_PX = 6.0  # of a detected line from an edge of the cross-section: two of its rows and three jitters
FATTENED_PX = 15.0  # by which depth may go on beyond the end of a face: half a matcher's window
CLEAR_SHARE = 0.75  # of the best score near an edge, from which another line counts as much
# For edges of these kinds, near and far (see `_fattened_side`). A tread and a riser that meet hide nothing. Where tread
# follows tread, going down, lines beside the edge were more often stripes than the edge itself.
FATTENED_SIDE = {(RISER, UNKNOWN): 1.0, (RISER, RISER): 1.0, (UNKNOWN, RISER): -1.0}
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
        ends_riser: (n,) whether a riser ends there whose depth may go on above it.
        profile: the cross-section.
    """

    lines: np.ndarray
    source: np.ndarray
    own_length: np.ndarray
    confirmed: np.ndarray
    ends_riser: np.ndarray
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
    match = _match(lines, drawn, profile.edges, match_px)
    connected = _connected(profile.edges, np.isin(np.arange(len(drawn)), match))
    shown = _shown(profile.edges, match)
    kept, source, confirmed, ends_riser = [], [], [], []
    for edge, row in enumerate(drawn):
        if np.isnan(row[4]) or not connected[edge] or not shown[edge]:
            continue
        taken = _of_one_edge(lines, np.nonzero(match == edge)[0], _fattened_side(profile.edges[edge]), match_px)
        if len(taken):
            kept.append(_join(lines[taken], row))
            source.append(int(taken[np.argmax(lines[taken, 7])]))
        else:
            kept.append(row)
            source.append(-1)
        confirmed.append(len(taken) > 0)
        ends_riser.append(_fattened_side(profile.edges[edge]) > 0.0)
    for index in np.nonzero((match < 0) & (lines[:, 6] >= SCORE_THRESHOLD))[0].tolist():
        if not _inside_a_face(lines[index], profile, camera_to_stair, intrinsics, match_px):
            kept.append(lines[index])
            source.append(index)
            confirmed.append(False)
            ends_riser.append(False)
    found = np.array(kept).reshape(-1, lines.shape[1])
    order = np.argsort(-(found[:, 4] * middle_x + found[:, 5]), kind="stable")
    origin = np.array(source, dtype=int)[order]
    own_length = np.where(origin >= 0, (lines[:, 2] - lines[:, 0])[origin], 0.0)
    both, ends = np.array(confirmed, dtype=bool)[order], np.array(ends_riser, dtype=bool)[order]
    return CheckedLines(found[order], origin, own_length, both, ends, profile)


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


def _shown(edges: tuple[ProfileEdge, ...], match: np.ndarray) -> np.ndarray:
    """(e,) whether an edge counts: by itself, or because a line shows it.

    Depth ends for other reasons than edges, so that the end of a riser needs a line. Where the tread between two risers
    is all but hidden, their meeting counts only until a line shows the end of the near one.
    """
    by_line = np.isin(np.arange(len(edges)), match)
    counts = by_line.copy()
    for index, edge in enumerate(edges):
        replaced = edge.near_kind == edge.far_kind == RISER and index > 0 and by_line[index - 1]
        replaced = replaced and edges[index - 1].far_kind == UNKNOWN
        counts[index] |= UNKNOWN not in (edge.near_kind, edge.far_kind) and not replaced
    return counts


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


def _match(lines: np.ndarray, drawn: np.ndarray, edges: tuple[ProfileEdge, ...], match_px: float) -> np.ndarray:
    """(m,) the edge that each line shows from end to end, -1 for none.

    Depth that was matched in windows is fattened: a face goes on for half a window over what lies farther away behind
    its end. The true end is the line within the face.
    """
    if len(drawn) == 0:
        return np.full(len(lines), -1)
    slope, offset = lines[:, 4] - drawn[:, 4:5], lines[:, 5] - drawn[:, 5:6]  # (e, m)
    below = 0.5 * (slope * (lines[:, 0] + lines[:, 2])) + offset  # in the image, pixels
    miss = 0.5 * (np.abs(slope * lines[:, 0] + offset) + np.abs(slope * lines[:, 2] + offset))
    inward = np.array([_fattened_side(edge) for edge in edges])[:, None]
    miss = np.where(inward * below > 0.0, miss * MATCH_PX / FATTENED_PX, miss)
    miss = np.where(np.isnan(miss), np.inf, miss)
    nearest = np.argmin(miss, axis=0)
    return np.where(miss[nearest, np.arange(len(lines))] < match_px, nearest, -1)


def _fattened_side(edge: ProfileEdge) -> float:
    """Where in the image the face lies that may go on beyond an edge: 1 below it, -1 above it, 0 nowhere."""
    return FATTENED_SIDE.get((edge.near_kind, edge.far_kind), 0.0)


def _of_one_edge(lines: np.ndarray, taken: np.ndarray, inward: float, match_px: float) -> np.ndarray:
    """Which of the lines that were matched to an edge are that edge.

    Where a tread is all but covered by what its neighbours' depth was fattened by, both of its edges come near: the
    end of the face that goes on is the one within it. Lines that score less are stripes on the face.
    """
    if inward == 0.0 or len(taken) < 2:
        return taken
    x = median((lines[taken, 0] + lines[taken, 2]) / 2.0)
    depth_in_face = inward * (lines[taken, 4] * x + lines[taken, 5])
    clear = lines[taken, 6] >= CLEAR_SHARE * lines[taken, 6].max()
    return taken[np.abs(depth_in_face - depth_in_face[clear].max()) < match_px]


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
