"""What a PyBullet body looks like, for viewers outside Bullet: its drawn parts, and where its links are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

# PyBullet's numbers of geometry types, so that PyBullet need not be imported.
_KINDS: dict[int, Literal["sphere", "box", "cylinder", "mesh", "capsule"]] = {
    2: "sphere",
    3: "box",
    4: "cylinder",
    5: "mesh",
    7: "capsule",
}
MIN_SIZE_M = 2e-3  # smaller parts are markers
BASE = -1

Pose = tuple[tuple[float, ...], tuple[float, ...]]  # position (3,) m, quaternion (x, y, z, w)


@dataclass(frozen=True)
class VisualPart:
    """One drawn part of a link.

    Attributes:
        link: PyBullet's index; -1 is the base.
        kind: "mesh" or a plain solid.
        size: box: whole lengths (x, y, z); sphere: (radius, 0, 0); cylinder, capsule along z: (length, radius, 0);
            mesh: factors on the file's axes.
        file: of a mesh, else empty.
        part_to_link: pose in the link's frame.
        colour: (3,) 0..1.
    """

    link: int
    kind: Literal["sphere", "box", "cylinder", "mesh", "capsule"]
    size: tuple[float, ...]
    file: str
    part_to_link: Pose
    colour: tuple[float, ...]


def visual_parts(client: Any, body: int) -> tuple[VisualPart, ...]:
    """The drawn parts of a body that was loaded with them (`Simulation(visible=True)`)."""
    return tuple(
        VisualPart(link, _KINDS[kind], tuple(size), file.decode(), (tuple(position), tuple(turn)), tuple(rgba[:3]))
        for _, link, kind, size, file, position, turn, rgba, *_ in client.getVisualShapeData(body)
        if kind in _KINDS and max(size) >= MIN_SIZE_M
    )


def link_poses(client: Any, body: int) -> dict[int, Pose]:
    """Where the frames of a body's links are now, world frame, by link; -1 is the base."""
    inertial_in_link = client.getDynamicsInfo(body, BASE)[3:5]
    inertial = client.getBasePositionAndOrientation(body)
    base = client.multiplyTransforms(*inertial, *client.invertTransform(*inertial_in_link))
    links = list(range(client.getNumJoints(body)))
    states = client.getLinkStates(body, links, computeForwardKinematics=1) if links else ()
    return {BASE: base, **{link: (state[4], state[5]) for link, state in zip(links, states)}}


def pose_matrix(pose: Pose) -> np.ndarray:
    """(4, 4) of a position and a quaternion (x, y, z, w)."""
    from scipy.spatial.transform import Rotation

    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = Rotation.from_quat(pose[1]).as_matrix(), pose[0]
    return transform
