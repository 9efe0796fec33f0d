"""The solids of a PyBullet body, so that the ray caster can draw what the physics moves."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stair_env.scene.shapes import Shape, ShapeKind, Vector3

# Numbers of PyBullet's geometry types, so that PyBullet need not be imported.
_SPHERE, _BOX, _CYLINDER, _MESH, _CAPSULE = 2, 3, 4, 5, 7
_BASE = -1
ROUNDNESS_TOLERANCE = 0.02  # of the radius; Bullet turns a URDF's cylinder into a prism of 32 sides
MIN_ROUND_VERTICES = 16  # the corners of a box lie on a cylinder too
MIN_SIZE_M = 2e-3  # smaller shapes are markers, not bodies


class BodyShapes:
    """Collision shapes of one body; their local frames are read once, then only the links' poses.

    Args:
        client: the PyBullet client that owns the body.
        body: its unique id.
        surface: `Shape.surface` of every shape.
    """

    def __init__(self, client: Any, body: int, surface: str = "robot") -> None:
        self._client, self._body, self._surface = client, body, surface
        self._links: list[int] = []
        self._kinds: list[ShapeKind] = []
        self._sizes: list[Vector3] = []
        positions: list[np.ndarray] = []
        rotations: list[Rotation] = []
        for link in range(_BASE, client.getNumJoints(body)):
            for kind, size, position, rotation in _local_shapes(client, body, link):
                self._links.append(link)
                self._kinds.append(kind)
                self._sizes.append(size)
                positions.append(position)
                rotations.append(rotation)
        self._positions = np.array(positions).reshape(-1, 3)
        self._rotations = Rotation.concatenate(rotations) if rotations else None
        self._moving_links = sorted({link for link in self._links if link != _BASE})
        place = {link: k + 1 for k, link in enumerate(self._moving_links)}
        self._row = np.array([place.get(link, 0) for link in self._links], dtype=np.int64)

    def shapes(self) -> list[Shape]:
        """The shapes where the body's links are now, world frame."""
        if self._rotations is None:
            return []
        poses = [self._client.getBasePositionAndOrientation(self._body)]
        if self._moving_links:
            states = self._client.getLinkStates(self._body, self._moving_links, computeForwardKinematics=1)
            poses.extend(state[:2] for state in states)  # of the inertial frames
        origins = np.array([pose[0] for pose in poses])[self._row]
        frames = Rotation.from_quat(np.array([pose[1] for pose in poses])[self._row])
        positions = (origins + frames.apply(self._positions)).tolist()
        orientations = (frames * self._rotations).as_quat().tolist()
        return [
            Shape(kind, tuple(position), size, tuple(orientation), self._surface)
            for kind, size, position, orientation in zip(self._kinds, self._sizes, positions, orientations)
        ]


def shapes_of_body(client: Any, body: int, surface: str = "robot") -> list[Shape]:
    """The collision shapes of a body where it is now; keep a `BodyShapes` to ask more than once.

    Args:
        client: the PyBullet client that owns the body.
        body: its unique id.
        surface: `Shape.surface` of every shape.

    Returns:
        Boxes, spheres, cylinders and capsules in the world frame; a mesh is replaced by a box or cylinder around it.
    """
    return BodyShapes(client, body, surface).shapes()


_Local = tuple[ShapeKind, Vector3, np.ndarray, Rotation]


def _local_shapes(client: Any, body: int, link: int) -> list[_Local]:
    """Kind, size, position and rotation in the link's inertial frame."""
    found: list[_Local] = []
    for number, data in enumerate(client.getCollisionShapeData(body, link)):
        geometry, dimensions = data[2], data[3]
        position, rotation = np.array(data[5]), Rotation.from_quat(data[6])
        if geometry == _BOX:
            half = (dimensions[0] / 2, dimensions[1] / 2, dimensions[2] / 2)
            found.append(("box", half, position, rotation))
        elif geometry == _SPHERE:
            found.append(("sphere", (dimensions[0], 0.0, 0.0), position, rotation))
        elif geometry in (_CYLINDER, _CAPSULE):
            kind: ShapeKind = "cylinder" if geometry == _CYLINDER else "capsule"
            found.append((kind, (dimensions[1], dimensions[0] / 2, 0.0), position, rotation))
        elif geometry == _MESH:
            _, vertices = client.getMeshData(body, link, collisionShapeIndex=number)
            if len(vertices) > 3:  # already in the inertial frame
                found.append(fit_solid(np.array(vertices)))
    return [shape for shape in found if max(shape[1]) >= MIN_SIZE_M]


def fit_solid(vertices: np.ndarray) -> _Local:
    """The cylinder that points lie on, else a small box around them.

    Args:
        vertices: (n, 3) metres.

    Returns:
        Kind ("cylinder" or "box"), size as in `Shape`, position (3,), and rotation to the frame of the points.
    """
    _, axes = np.linalg.eigh(np.cov(vertices.T))
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0
    boxes = [_bounding_box(vertices, frame) for frame in (np.eye(3), axes)]
    half, centre, frame = min(boxes, key=lambda box: float(np.prod(box[0])))
    local = (vertices - centre) @ frame
    for axis in range(3):
        radius = np.hypot(local[:, axis - 2], local[:, axis - 1])
        if len(vertices) >= MIN_ROUND_VERTICES and radius.min() > (1.0 - ROUNDNESS_TOLERANCE) * radius.max():
            # A cyclic exchange of axes keeps the frame right-handed and makes this one z.
            turned = frame[:, [axis - 2, axis - 1, axis]]
            return "cylinder", (float(radius.max()), float(half[axis]), 0.0), centre, Rotation.from_matrix(turned)
    size: Vector3 = (float(half[0]), float(half[1]), float(half[2]))
    return "box", size, centre, Rotation.from_matrix(frame)


def _bounding_box(vertices: np.ndarray, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Half extents, centre and the given axes (columns) of the box around the points."""
    local = vertices @ frame
    low, high = local.min(axis=0), local.max(axis=0)
    return (high - low) / 2.0, frame @ ((low + high) / 2.0), frame
