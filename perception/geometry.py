"""From stair lines and depth to step width and step height ("Acquisition of geometric stair parameters").

Frames, all right-handed and centred in the colour imager: *camera* (x right, y down, z forward), *level* (the same
after undoing roll and pitch: y along gravity, z horizontal), *stair* (f forward along the walking direction, l left,
h up). Two methods give the same result type: "planes", the default, which fits treads and risers
(`perception.faces`), and "paper", equations 7 to 9 to the letter (`perception.paper_geometry`).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from perception.estimate import Nosing, StepMeasurement
from perception.faces import RISER, TREAD, UNKNOWN, Faces, fit_faces, sample_strips
from stair_env.camera.intrinsics import Intrinsics

OMEGA_M = 0.05  # the paper's threshold: smaller widths and heights are noise of one and the same face
MIN_SUPPORT = 2  # cell predictions behind a line
MAX_RISER_M, MAX_TREAD_M = 0.25, 0.50  # larger is no stair
MAX_HIDDEN_RUN_M = 0.45  # of the tread below a nosing; when more is out of sight, a whole step may be
LINE_JITTER_PX = 1.0  # of a detected line, in pixels of the 512 x 512 image
GRAVITY_STD_RAD = math.radians(0.7)  # fused attitude on a walking robot, with some margin
SCALE_STD = 0.003  # a calibrated D435i: within 0.5 %, uniform
MAX_YAW_RAD = math.radians(70.0)
DOWN, UP = -1, 1


@dataclass(frozen=True)
class Geometry:
    """What one frame says about the staircase (see `perception.estimate.StairEstimate` for the fields)."""

    direction: int = 0
    nosings: tuple[Nosing, ...] = ()
    steps: tuple[StepMeasurement, ...] = ()
    yaw_rad: float = 0.0
    yaw_std_rad: float = 0.0
    kinds: tuple[str, ...] = ()
    reason: str = ""


@dataclass
class _Profile:
    """The staircase's cross-section while it is put together; one entry per face, nearest first.

    Attributes:
        kind, value, std: as in `Faces`.
        line: index of the line between this face and the next one.
    """

    kind: list[int] = field(default_factory=list)
    value: list[float] = field(default_factory=list)
    std: list[float] = field(default_factory=list)
    line: list[int] = field(default_factory=list)


def attitude_angles(gravity: np.ndarray) -> tuple[float, float]:
    """(pitch, roll) by the paper's equation 8, radians; head up and right side down are positive.

    Args:
        gravity: (3,) accelerometer reading at rest, camera frame, any unit; (0, -9.8, 0) when level.
    """
    x, _, z = np.asarray(gravity, dtype=np.float64) / np.linalg.norm(gravity)
    return math.asin(float(np.clip(z, -1.0, 1.0))), math.asin(float(np.clip(-x, -1.0, 1.0)))


def camera_to_level(gravity: np.ndarray) -> np.ndarray:
    """(3, 3) rotation that undoes roll and pitch and keeps the heading of the optical axis.

    Args:
        gravity: (3,) accelerometer reading at rest, camera frame, any unit.
    """
    down = -np.asarray(gravity, dtype=np.float64) / np.linalg.norm(gravity)
    axis = np.array([0.0, 0.0, 1.0])
    if abs(down[2]) > 0.999:  # looks straight down or up: heading is that of the image's upper edge
        axis = np.array([0.0, -math.copysign(1.0, -down[2]), 0.0])
    forward = axis - (axis @ down) * down
    forward /= np.linalg.norm(forward)
    return np.stack([np.cross(down, forward), down, forward])


def level_to_stair(yaw_rad: float) -> np.ndarray:
    """(3, 3) rotation from the level frame (right, down, forward) to (f, l, h), for a camera that looks to the right
    of the walking direction by yaw_rad."""
    sin, cos = math.sin(yaw_rad), math.cos(yaw_rad)
    return np.array([[-sin, 0.0, cos], [-cos, 0.0, -sin], [0.0, -1.0, 0.0]])


def line_normals(lines: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """(m, 3) unit normals, camera frame, of the planes through the camera and the image lines; they point down.

    Args:
        lines: (m, 8) rows of `perception.lines.LINE_FIELDS`, pixels.
        intrinsics: of that image.
    """
    # y = k x + b in pixels, with x = fx X / Z + cx and y = fy Y / Z + cy, is a plane through the origin.
    k, b = lines[:, 4], lines[:, 5]
    fx, fy, cx, cy = intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy
    normals = np.stack([-k * fx, np.full(len(k), fy), cy - k * cx - b], axis=1)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def yaw_from_lines(normals_level: np.ndarray, lengths: np.ndarray) -> float:
    """Yaw of the camera relative to the stairs from horizontal lines, no depth needed.

    A horizontal line in space that projects to an image line is the intersection of that line's plane through the
    camera with the horizontal, so that its direction follows from gravity alone.

    Args:
        normals_level: (m, 3) plane normals in the level frame.
        lengths: (m,) of the lines in the image; the weight of each.

    Returns:
        Weighted median, radians, positive when the camera looks to the right of the walking direction.
    """
    direction = np.stack([normals_level[:, 2], -normals_level[:, 0]], axis=1)  # (X, Z) of n x up
    strength = np.linalg.norm(direction, axis=1)
    direction = np.where(direction[:, :1] < 0.0, -direction, direction)
    yaw = np.arctan2(direction[:, 1], np.maximum(direction[:, 0], 1e-9))
    order = np.argsort(yaw)
    weight = np.cumsum((strength * lengths)[order])
    return float(yaw[order][np.searchsorted(weight, weight[-1] / 2.0)])


def measure_stairs(
    lines: np.ndarray,
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
    gravity: np.ndarray,
    *,
    omega_m: float = OMEGA_M,
    gravity_std_rad: float = GRAVITY_STD_RAD,
) -> Geometry:
    """Cross-section of the staircase by fitting its treads and risers.

    Args:
        lines: (m, 8) rows of `perception.lines.LINE_FIELDS`, pixels of the depth image, any order.
        depth_m: (H, W) float, metres, 0 = no reading.
        intrinsics: of the depth image.
        gravity: (3,) accelerometer reading at rest, camera frame.
        omega_m: smallest width and height that counts, metres.
        gravity_std_rad: standard deviation of the gravity direction.

    Returns:
        Geometry whose kinds have one entry per row of `lines`.
    """
    used = np.nonzero(lines[:, 7] >= MIN_SUPPORT)[0] if len(lines) else np.empty(0, dtype=int)
    unknown = ("unknown",) * len(lines)
    if len(used) == 0:
        return Geometry(kinds=unknown, reason="no stair lines")
    used = used[np.argsort(-_height_at_middle(lines[used]))]
    chosen = lines[used]
    level = camera_to_level(gravity)
    normals = line_normals(chosen, intrinsics)
    lengths = chosen[:, 2] - chosen[:, 0]
    yaw = yaw_from_lines(normals @ level.T, lengths)
    if abs(yaw) > MAX_YAW_RAD:
        return Geometry(kinds=unknown, reason="the lines run away from the camera")
    strips = sample_strips(chosen, depth_m, intrinsics)
    jitter_px = LINE_JITTER_PX * max(intrinsics.width, intrinsics.height) / 512.0
    slope_std = jitter_px * 2.5 / np.maximum(lengths, 1.0)  # sqrt(12 / 2): ends and middle each vote
    faces = fit_faces(strips, level_to_stair(yaw) @ level, normals, slope_std, gravity_std_rad)
    profile = _merge_equal_faces(faces, omega_m)
    direction = _direction(profile, omega_m)
    if direction == 0:
        return Geometry(kinds=unknown, reason="no height differences between the lines")
    rays = _LineRays(chosen, intrinsics, faces.camera_to_stair, jitter_px)
    nosings, kinds_used = _nosings(profile, direction, rays, faces, omega_m)
    kinds = list(unknown)
    for index, kind in kinds_used.items():
        kinds[used[index]] = kind
    refined_yaw = _camera_yaw(faces.camera_to_stair)
    return Geometry(
        direction,
        nosings,
        _steps(nosings),
        refined_yaw,
        math.sqrt(float(faces.angle_cov[2, 2])),
        tuple(kinds),
        "" if any(nosing.riser_m for nosing in nosings) else "no complete riser in view",
    )


def _height_at_middle(lines: np.ndarray) -> np.ndarray:
    """(m,) image y of every line at one common column, where most of them are."""
    x = float(np.median((lines[:, 0] + lines[:, 2]) / 2.0))
    return lines[:, 4] * x + lines[:, 5]


def _camera_yaw(camera_to_stair: np.ndarray) -> float:
    """Heading of the optical axis relative to the walking direction, positive to the right."""
    f, left, _ = camera_to_stair[:, 2]
    return math.atan2(-float(left), float(f))


def _merge_equal_faces(faces: Faces, omega_m: float) -> _Profile:
    """Drop lines that divide one and the same face (painted stripes, tiles): the paper's filter of equation 9."""
    profile = _Profile()
    for index, kind in enumerate(faces.kind):
        value, std = float(faces.value[index]), float(faces.std[index])
        if profile.kind and kind != UNKNOWN and kind == profile.kind[-1] and abs(value - profile.value[-1]) < omega_m:
            a, b = profile.std[-1] ** -2, std**-2
            profile.value[-1] = (a * profile.value[-1] + b * value) / (a + b)
            profile.std[-1] = (a + b) ** -0.5
            profile.line[-1] = index
            continue
        profile.kind.append(int(kind))
        profile.value.append(value)
        profile.std.append(std)
        profile.line.append(index)  # the line above strip i is line i
    return profile


def _direction(profile: _Profile, omega_m: float) -> int:
    """+1 when heights grow away from the camera, -1 when they fall.

    The paper's rule, both kinds of lines seen means ascending, is the same thing: a riser can only be seen from below.
    """
    votes = sum(1 for kind in profile.kind if kind == RISER)
    heights = [value for kind, value in zip(profile.kind, profile.value) if kind == TREAD]
    for near, far in itertools.pairwise(heights):
        if abs(far - near) >= omega_m:
            votes += 1 if far > near else -1
    return int(np.sign(votes))


class _LineRays:
    """Intersections of the detected lines' viewing planes with treads and risers, in the stair frame."""

    def __init__(
        self, lines: np.ndarray, intrinsics: Intrinsics, camera_to_stair: np.ndarray, jitter_px: float
    ) -> None:
        t = np.linspace(0.05, 0.95, 9)  # the paper's nine sampling points
        x = lines[:, :1] + (lines[:, 2:3] - lines[:, :1]) * t
        y = lines[:, 4:5] * x + lines[:, 5:6]
        ones = np.ones_like(x)
        nominal = np.stack([(x - intrinsics.cx) / intrinsics.fx, (y - intrinsics.cy) / intrinsics.fy, ones], axis=2)
        lower = nominal.copy()
        lower[..., 1] += jitter_px / intrinsics.fy
        self._rays = np.stack([nominal @ camera_to_stair.T, lower @ camera_to_stair.T])  # (2, m, 9, 3)

    def height_on_riser(self, line: int, forward_m: float) -> tuple[float, float]:
        """Height at which a line crosses the riser plane f = forward_m, and its standard deviation."""
        rays = self._rays[:, line]
        nominal, lower = (forward_m * rays[..., 2] / np.maximum(rays[..., 0], 1e-3)).mean(axis=1)
        return float(nominal), abs(float(lower - nominal))

    def forward_on_tread(self, line: int, height_m: float) -> tuple[float, float]:
        """Forward distance at which a line crosses the tread h = height_m, and its standard deviation."""
        rays = self._rays[:, line]
        rise = rays[..., 2]
        if (rise * height_m <= 1e-4).any():  # looks away from the tread, or along it
            return 0.0, math.inf
        nominal, lower = (height_m * rays[..., 0] / rise).mean(axis=1)
        return float(nominal), abs(float(lower - nominal))


@dataclass
class _Edge:
    """A nosing while the profile is read: index of the faces before and after it in the profile."""

    forward: float
    forward_std: float
    height: float
    height_std: float
    before: int
    after: int


def _nosings(
    profile: _Profile, direction: int, rays: _LineRays, faces: Faces, omega_m: float
) -> tuple[tuple[Nosing, ...], dict[int, str]]:
    """Nosings nearest first, and the kind of every line that was understood."""
    kinds: dict[int, str] = {}
    edges: list[_Edge] = []
    for index in range(len(profile.kind) - 1):
        pair = (profile.kind[index], profile.kind[index + 1])
        line = profile.line[index]
        if direction == UP and pair[1] == RISER and pair[0] in (TREAD, UNKNOWN):
            kinds[line] = "concave"
        edge = _ascending_edge(profile, index, rays, omega_m) if direction == UP else None
        if direction == DOWN:
            edge = _descending_edge(profile, index, rays, omega_m)
        if edge is not None:
            kinds[line] = "convex"
            edges.append(edge)
    pitch_std = math.sqrt(float(faces.angle_cov[1, 1]))
    finished = [_finish(profile, direction, edges, index, pitch_std, omega_m) for index in range(len(edges))]
    return tuple(finished), kinds


def _ascending_edge(profile: _Profile, index: int, rays: _LineRays, omega_m: float) -> _Edge | None:
    """The nosing at the top of riser `index`: forward from the riser, height from the tread and from the line."""
    if profile.kind[index] != RISER:
        return None
    forward, forward_std = profile.value[index], profile.std[index]
    height, height_std = rays.height_on_riser(profile.line[index], forward)
    after = profile.kind[index + 1]
    if after == RISER and profile.value[index + 1] < forward + omega_m:
        return None
    if after == TREAD:
        if abs(profile.value[index + 1] - height) > omega_m:  # a line on the riser, not at its top
            return None
        a, b = height_std**-2, profile.std[index + 1] ** -2
        height = (a * height + b * profile.value[index + 1]) / (a + b)
        height_std = (a + b) ** -0.5
    return _Edge(forward, forward_std, height, height_std, index, index + 1)


def _descending_edge(profile: _Profile, index: int, rays: _LineRays, omega_m: float) -> _Edge | None:
    """The nosing at the far end of tread `index`: height from the tread, forward where the line crosses it."""
    if profile.kind[index] != TREAD:
        return None
    if profile.kind[index + 1] == TREAD and profile.value[index + 1] > profile.value[index] - omega_m:
        return None
    forward, forward_std = rays.forward_on_tread(profile.line[index], profile.value[index])
    if not math.isfinite(forward_std):
        return None
    return _Edge(forward, forward_std, profile.value[index], profile.std[index], index, index + 1)


def _finish(
    profile: _Profile, direction: int, edges: list[_Edge], index: int, pitch_std: float, omega_m: float
) -> Nosing:
    """Add riser and tread, where the faces that bound them are known and adjoin."""
    edge = edges[index]
    far = edges[index + 1] if index + 1 < len(edges) else None
    near = edges[index - 1] if index > 0 else None
    riser = riser_std = tread = tread_std = None
    level = _level_beside(profile, direction, edge, near)
    if level is not None and not _may_hide_a_step(direction, edge, level[0]):
        riser = abs(edge.height - level[0])
        riser_std = math.sqrt(edge.height_std**2 + level[1] ** 2 + (pitch_std * 0.3) ** 2 + (SCALE_STD * riser) ** 2)
        if not omega_m <= riser <= MAX_RISER_M:
            riser = riser_std = None
    if far is not None and far.before - edge.before <= 2 and _adjoins(profile, edge, far):
        tread = far.forward - edge.forward
        tread_std = math.sqrt(
            edge.forward_std**2 + far.forward_std**2 + (pitch_std * 0.15) ** 2 + (SCALE_STD * tread) ** 2
        )
        if not omega_m <= tread <= MAX_TREAD_M or (direction == DOWN and riser is None):
            tread = tread_std = None
    distance_std = math.hypot(edge.forward_std, SCALE_STD * edge.forward)
    height_std = math.hypot(edge.height_std, pitch_std * edge.forward)
    return Nosing(edge.forward, distance_std, edge.height, height_std, riser, riser_std, tread, tread_std)


def _may_hide_a_step(direction: int, edge: _Edge, lower_m: float) -> bool:
    """Whether the line of sight over a descending nosing meets the next tread in view too far behind it.

    A step is out of sight when the view over the nosing is flatter than the stairs; what is seen next then lies more
    than two treads behind.
    """
    if direction == UP:
        return False
    view = max(-edge.height, 1e-3) / max(edge.forward, 1e-3)
    return (edge.height - lower_m) / view > MAX_HIDDEN_RUN_M


def _adjoins(profile: _Profile, edge: _Edge, far: _Edge) -> bool:
    """Whether nothing unknown lies between two nosings."""
    return all(profile.kind[face] != UNKNOWN for face in range(edge.before, far.before + 1))


def _level_beside(profile: _Profile, direction: int, edge: _Edge, near: _Edge | None) -> tuple[float, float] | None:
    """Height and standard deviation of the lower level at a nosing: before it going up, beyond it going down."""
    face = edge.after if direction == DOWN else edge.before - 1
    if 0 <= face < len(profile.kind) and profile.kind[face] == TREAD:
        return profile.value[face], profile.std[face]
    if direction == UP and near is not None and face == near.before:  # the tread hides behind the nosing below
        return near.height, near.height_std
    return None


def _steps(nosings: tuple[Nosing, ...]) -> tuple[StepMeasurement, ...]:
    """Equation 9: the steps whose width and height are both known, nearest first."""
    return tuple(
        StepMeasurement(n.tread_m, n.riser_m, n.tread_std_m or 0.0, n.riser_std_m or 0.0, n.distance_m)
        for n in nosings
        if n.tread_m is not None and n.riser_m is not None
    )
