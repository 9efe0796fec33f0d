"""Depth as the colour camera would have measured it: each reading moved to where colour sees the same place.

A reading covers the colour pixels between the images of its own pixel's corners; where several meet, the nearest hides
the others. Importing this module loads numba.
"""

from __future__ import annotations

import numpy as np

from stair_env.common.compiling import njit
from stair_env.intrinsics import Intrinsics

MAX_SPREAD_PX = 8.0  # of one reading in the colour image: more is a reading next to the lens


def align_depth(
    depth_m: np.ndarray, depth_intrinsics: Intrinsics, depth_to_colour: np.ndarray, colour_intrinsics: Intrinsics
) -> np.ndarray:
    """Move a depth image into the colour camera.

    Args:
        depth_m: float32 (H', W') metres, 0 = no reading, rectified.
        depth_intrinsics: of that image.
        depth_to_colour: (4, 4) rigid transform.
        colour_intrinsics: of the colour image.

    Returns:
        float32 (H, W) metres along the colour camera's axis, 0 = no reading.
    """
    aligned = np.zeros((colour_intrinsics.height, colour_intrinsics.width), np.float32)
    d, c = depth_intrinsics, colour_intrinsics
    _move(
        np.ascontiguousarray(depth_m, np.float32),
        np.array([d.fx, d.fy, d.cx, d.cy]),
        np.ascontiguousarray(depth_to_colour, np.float64),
        np.array([c.fx, c.fy, c.cx, c.cy]),
        aligned,
    )
    return aligned


@njit(cache=True, nogil=True)
def _move(depth: np.ndarray, source: np.ndarray, pose: np.ndarray, target: np.ndarray, aligned: np.ndarray) -> None:
    rows, columns = depth.shape
    height, width = aligned.shape
    for row in range(rows):
        for column in range(columns):
            z = depth[row, column]
            if not z > 0.0:
                continue
            left, top, right, bottom, far = 0.0, 0.0, 0.0, 0.0, 0.0
            for corner in range(2):  # upper left, lower right
                x = (column + corner - source[2]) / source[0] * z
                y = (row + corner - source[3]) / source[1] * z
                cx = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
                cy = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
                cz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
                if not cz > 0.0:
                    far = 0.0
                    break
                u, v = target[0] * cx / cz + target[2], target[1] * cy / cz + target[3]
                far += 0.5 * cz
                if corner == 0:
                    left, top = u, v
                else:
                    right, bottom = u, v
            if not far > 0.0 or right - left > MAX_SPREAD_PX or bottom - top > MAX_SPREAD_PX:
                continue
            # The pixels whose centres lie between the corners, and at least the one that holds the middle.
            first_u, last_u = int(np.ceil(left - 0.5)), int(np.ceil(right - 0.5)) - 1
            first_v, last_v = int(np.ceil(top - 0.5)), int(np.ceil(bottom - 0.5)) - 1
            if last_u < first_u:
                first_u = last_u = int(np.floor((left + right) / 2))
            if last_v < first_v:
                first_v = last_v = int(np.floor((top + bottom) / 2))
            for v_pixel in range(max(first_v, 0), min(last_v, height - 1) + 1):
                for u_pixel in range(max(first_u, 0), min(last_u, width - 1) + 1):
                    known = aligned[v_pixel, u_pixel]
                    if known == 0.0 or far < known:
                        aligned[v_pixel, u_pixel] = far
