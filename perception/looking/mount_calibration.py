"""Where a camera sits on a robot, from the floor or the stairs that it sees while the robot stands still.

A plane's inverse depth is linear across the image, and a stereo camera's noise of inverse depth is the same everywhere:
so planes are fitted there, without the tilt that noise along the rays gives to planes fitted through points. Level
patches, of a floor as of treads, share one direction: up. The level nearest to the camera is what the robot stands on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stair_env.common.constants import LEVEL_CAMERA_GRAVITY
from stair_env.intrinsics import Intrinsics

PATCH_PX = 16
MIN_VALID = 0.6  # of a patch's pixels
MIN_PATCHES = 12
PRIOR_RAD = math.radians(20.0)  # between a level patch and the IMU's up
BLIND_PRIOR_RAD = math.radians(
    65.0
)  # and a level camera's, when nobody says: a head camera looks down by up to 50 degrees
AGREE_RAD = math.radians(6.0)  # patches of 16 x 16 pixels at 2 m are tilted by noise by some 2 degrees
FAR_M = 3.0  # beyond it a patch says little
LEVEL_STEP_M = 0.05  # levels are at least so far apart: risers are higher
LEAST_LEVEL, LEAST_LEVEL_SHARE, MAX_LEVELS = 4, 0.04, 8  # patches of a level: at least, and as a share of all
DEPTH_SCALE_STD = 0.003  # of a D435i's depth: of one unit, after its own calibration (docs/measuring.md)
LEVEL_STD_RAD = math.radians(0.1)  # how level floors and treads are
EDGE_FACTOR = 1.5  # of the median scatter of patches, beyond which one is no plane
LEAST_SCATTER = 0.002  # 1/m, of exact depth in whole millimetres
OUTLIER = 3.0  # standard deviations from a level, beyond which a patch lies across an edge
ROUNDS = 20
STEPS = 4


class CalibrationFailed(ValueError):
    """No frame shows enough of a floor or stairs; the message says what was seen."""


@dataclass(frozen=True)
class Mount:
    """Camera against the trunk.

    Attributes:
        height_m, height_std_m: of the colour imager above what the robot stands on.
        pitch_down_rad, pitch_std_rad: tilt of the optical axis below the trunk's x axis.
        roll_rad, roll_std_rad: right side down positive.
        frames: that were used.
        levels: level surfaces in view, at most: one is a floor, more are stairs.
    """

    height_m: float
    height_std_m: float
    pitch_down_rad: float
    pitch_std_rad: float
    roll_rad: float
    roll_std_rad: float
    frames: int
    levels: int

    def to_dict(self) -> dict[str, Any]:
        """JSON form."""
        return dict(self.__dict__)


@dataclass(frozen=True)
class _View:
    """What one frame shows: up (3,) in camera axes, height of the camera above the nearest level, levels in view."""

    up: np.ndarray
    height_m: float
    levels: int


def calibrate_mount(
    frames: Sequence[tuple[np.ndarray, Intrinsics, np.ndarray | None]],
    trunk_up: np.ndarray | None = None,
) -> Mount:
    """Mount of a camera from frames of a robot that stands still.

    Args:
        frames: depth float32 (H, W) metres with 0 = no reading, its intrinsics, and gravity (3,) as an accelerometer at
            rest reads it in camera axes, or None.
        trunk_up: (3,) up in the trunk's axes (its accelerometer at rest); None: the trunk is level.

    Returns:
        The mean over frames. Standard deviations join what frames differ by with how level floors are and how well a
        device knows its depth.

    Raises:
        CalibrationFailed: no frame shows a floor or stairs.
        ValueError: trunk_up has no direction.
    """
    views, reason = [], "no frames"
    for depth, intrinsics, gravity in frames:
        try:
            views.append(level_view(depth, intrinsics, gravity))
        except CalibrationFailed as error:
            reason = str(error)
    if not views:
        raise CalibrationFailed(f"no frame can be used: {reason}")
    base_up = np.array([0.0, 0.0, 1.0]) if trunk_up is None else np.asarray(trunk_up, np.float64)
    length = float(np.linalg.norm(base_up))
    if base_up.shape != (3,) or not length > 0.0:
        raise ValueError(f"trunk_up={trunk_up!r} must be three numbers with a direction")
    angles = np.array([mount_angles(view.up, base_up / length) for view in views])
    heights = np.array([view.height_m for view in views])
    count = math.sqrt(len(views))
    spread = angles.std(axis=0, ddof=1) / count if len(views) > 1 else np.full(2, LEVEL_STD_RAD)
    height_spread = heights.std(ddof=1) / count if len(views) > 1 else 0.002
    height = float(heights.mean())
    return Mount(
        height_m=height,
        height_std_m=math.hypot(float(height_spread), DEPTH_SCALE_STD * height),
        pitch_down_rad=float(angles[:, 0].mean()),
        pitch_std_rad=math.hypot(float(spread[0]), LEVEL_STD_RAD),
        roll_rad=float(angles[:, 1].mean()),
        roll_std_rad=math.hypot(float(spread[1]), LEVEL_STD_RAD),
        frames=len(views),
        levels=max(view.levels for view in views),
    )


def mount_angles(camera_up: np.ndarray, trunk_up: np.ndarray) -> tuple[float, float]:
    """Pitch down and roll of a camera that looks along the trunk's x axis, from up in both frames' axes, radians.

    Args:
        camera_up: (3,) unit vector, camera axes.
        trunk_up: (3,) unit vector, trunk axes.
    """
    from scipy.optimize import least_squares

    def off(angles: np.ndarray) -> np.ndarray:
        found: np.ndarray = camera_to_trunk(*angles) @ camera_up - trunk_up
        return found

    start = [-math.asin(min(max(float(camera_up[2]), -1.0), 1.0)), 0.0]
    pitch_down, roll = least_squares(off, start).x
    return float(pitch_down), float(roll)


def camera_to_trunk(pitch_down: float, roll: float) -> np.ndarray:
    """(3, 3) rotation of a camera that looks ahead, tilted down, its right side down by roll."""
    cos, sin = math.cos(pitch_down), math.sin(pitch_down)
    right, down, ahead = np.array([0.0, -1.0, 0.0]), np.array([-sin, 0.0, -cos]), np.array([cos, 0.0, -sin])
    turned_right = math.cos(roll) * right + math.sin(roll) * down
    turned_down = math.cos(roll) * down - math.sin(roll) * right
    return np.column_stack([turned_right, turned_down, ahead])


def level_view(depth_m: np.ndarray, intrinsics: Intrinsics, gravity: np.ndarray | None) -> _View:
    """Up and height from one frame.

    Raises:
        CalibrationFailed: too little of it is level.
    """
    normals, rays, inverse = _patches(depth_m, intrinsics)
    prior = np.asarray(LEVEL_CAMERA_GRAVITY if gravity is None else gravity, np.float64)
    prior = prior / np.linalg.norm(prior)
    limit = math.cos(BLIND_PRIOR_RAD if gravity is None else PRIOR_RAD)
    level = normals @ prior > limit
    if level.sum() < MIN_PATCHES:
        raise CalibrationFailed(f"{int(level.sum())} patches of the picture are level, needed are {MIN_PATCHES}")
    up = _most_common(normals[level])
    for _ in range(ROUNDS):
        agree = level & (normals @ up > math.cos(AGREE_RAD))
        if agree.sum() < MIN_PATCHES:
            raise CalibrationFailed("no direction that enough level patches share")
        labels = _levels(-(rays[agree] @ up) / inverse[agree])
        if labels.max() < 0:
            raise CalibrationFailed("no height that enough level patches share")
        before, (up, kept) = up, _trimmed_fit(rays[agree], inverse[agree], labels, up)
        if np.dot(before, up) > 1.0 - 1e-14:
            break
    rays, inverse, labels = rays[agree][kept], inverse[agree][kept], labels[kept]
    heights = -(rays @ up) / inverse
    distances = np.sqrt(np.maximum((rays**2).sum(axis=1) / inverse**2 - heights**2, 0.0))
    real = np.unique(labels)
    nearest = min(real, key=lambda k: np.quantile(distances[labels == k], 0.2))
    return _View(up, float(np.median(heights[labels == nearest])), len(real))


def _patches(depth_m: np.ndarray, intrinsics: Intrinsics) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Planes of patches: (n, 3) unit normals towards the camera, rays of their middles, inverse depth there."""
    height, width = (side // PATCH_PX * PATCH_PX for side in depth_m.shape)
    rows, columns = height // PATCH_PX, width // PATCH_PX

    def cut(image: np.ndarray) -> np.ndarray:
        tail = image.shape[2:]
        blocks = image[:height, :width].reshape(rows, PATCH_PX, columns, PATCH_PX, *tail)
        return np.moveaxis(blocks, 2, 1).reshape(rows * columns, PATCH_PX * PATCH_PX, *tail)

    depth, rays = cut(np.asarray(depth_m, np.float64)), cut(intrinsics.rays())
    valid = (depth > 0.1) & (depth < FAR_M)
    good = valid.mean(axis=1) >= MIN_VALID
    depth, rays, valid = depth[good], rays[good], valid[good]
    inverse = np.where(valid, 1.0 / np.where(valid, depth, 1.0), 0.0)
    weight = valid[..., None].astype(np.float64)
    gram = np.einsum("npi,npj->nij", rays * weight, rays)
    planes = np.linalg.solve(gram, np.einsum("npi,np->ni", rays * weight, inverse)[..., None])[..., 0]
    off = np.where(valid, inverse - np.einsum("npi,ni->np", rays, planes), 0.0)
    scatter = np.sqrt((off**2).sum(axis=1) / valid.sum(axis=1))
    # An edge runs through the others: noise of inverse depth is alike everywhere.
    flat = scatter < max(EDGE_FACTOR * float(np.median(scatter)) if len(scatter) else 0.0, LEAST_SCATTER)
    length = np.linalg.norm(planes, axis=1)
    flat &= length > 0.0
    middle = rays.mean(axis=1)
    at_middle = np.einsum("ni,ni->n", middle, planes)
    flat &= at_middle > 0.0
    return -planes[flat] / length[flat, None], middle[flat], at_middle[flat]


def _most_common(normals: np.ndarray) -> np.ndarray:
    """(3,) the normal that most others agree with."""
    close = normals @ normals.T > math.cos(AGREE_RAD)
    mean: np.ndarray = normals[close[int(close.sum(axis=1).argmax())]].mean(axis=0)
    return mean / float(np.linalg.norm(mean))


def _levels(heights: np.ndarray) -> np.ndarray:
    """(n,) labels 0, 1, ... of values that crowd together, most crowded first; -1 for what lies between the crowds."""
    labels = np.full(len(heights), -1, np.int64)
    free = np.ones(len(heights), bool)
    enough = max(LEAST_LEVEL, LEAST_LEVEL_SHARE * len(heights))
    for label in range(MAX_LEVELS):
        near = np.abs(heights[:, None] - heights[None]) < LEVEL_STEP_M / 2
        counts = np.where(free, (near & free).sum(axis=1), 0)
        best = int(counts.argmax())
        if counts[best] < enough:
            break
        middle = float(np.median(heights[near[best] & free]))
        labels[free & (np.abs(heights - middle) < LEVEL_STEP_M / 2)] = label
        free &= np.abs(heights - middle) >= LEVEL_STEP_M
    return labels


def _trimmed_fit(
    rays: np.ndarray, inverse: np.ndarray, labels: np.ndarray, up: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`_joint_fit` without patches that lie across an edge: up (3,), and which were kept (n,) bool."""
    kept = known = labels >= 0
    for _ in range(4):
        up, scale = _joint_fit(rays[kept], inverse[kept], labels[kept], labels.max() + 1, up)
        off = inverse + (rays @ up) * scale[labels]
        spread = 1.4826 * float(np.median(np.abs(off[kept])))
        kept = known & (np.abs(off) <= max(OUTLIER * spread, LEAST_SCATTER))
    return up, kept


def _joint_fit(
    rays: np.ndarray, inverse: np.ndarray, labels: np.ndarray, count: int, up: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The up (3,) that levels share, and 1 / height of each (count,), by least squares of inverse depth.

    inverse = -(up . ray) / height_level. A level alone, a tread seen flat, hardly knows its tilt: up and all heights
    are solved together, by Gauss and Newton's steps from a first up.
    """
    along = -(rays @ up)
    scale = np.bincount(labels, along * inverse, count) / np.maximum(np.bincount(labels, along * along, count), 1e-12)
    for _ in range(STEPS):
        along = -(rays @ up)
        off = inverse - along * scale[labels]
        # Unknown: a turn of up (its length is held by the last row) and a change of each level's scale.
        jacobian = np.zeros((len(rays) + 1, 3 + count))
        jacobian[:-1, :3] = -rays * scale[labels][:, None]
        jacobian[np.arange(len(rays)), 3 + labels] = along
        jacobian[-1, :3] = 1e3 * up
        step, *_ = np.linalg.lstsq(jacobian, np.append(off, 0.0), rcond=None)
        up, scale = up + step[:3], scale + step[3:]
        up = up / np.linalg.norm(up)
    return up, scale
