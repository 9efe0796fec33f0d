"""The solids of a robot in MuJoCo, for the ray-caster."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from stair_env.physics.mujoco_model import KINDS
from stair_env.scene.shapes import IDENTITY, Quaternion, Shape, ShapeKind, Vector3, vector3

MIN_SIZE_M = 2e-3  # smaller shapes are markers, not bodies
_NAMES: dict[int, ShapeKind] = {int(kind): name for name, kind in KINDS.items()}  # type: ignore[misc]


class GeomShapes:
    """Every geometry that belongs to a body; a mesh is replaced by a box or cylinder around it.

    Args:
        model, data: of MuJoCo.
        surface: `Shape.surface` of every shape.
    """

    def __init__(self, model: Any, data: Any, surface: str = "robot") -> None:
        self._model, self._data, self._surface = model, data, surface
        self._parts: list[tuple[int, ShapeKind, Vector3, np.ndarray, np.ndarray]] = []
        for geom in np.flatnonzero(model.geom_bodyid > 0).tolist():
            kind, size, place, turn = self._local(geom)
            if max(size) >= MIN_SIZE_M:
                self._parts.append((geom, kind, size, place, turn))

    def _local(self, geom: int) -> tuple[ShapeKind, Vector3, np.ndarray, np.ndarray]:
        """Kind, size, place and quaternion (w, x, y, z) of a solid in its geometry's frame."""
        model = self._model
        kind = _NAMES.get(int(model.geom_type[geom]))
        if kind is not None:
            return kind, vector3(model.geom_size[geom]), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        from stair_env.sensors.camera.renderers.bullet_shapes import fit_solid  # SciPy, which blind workers do without

        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        fitted, size, place, rotation = fit_solid(np.array(model.mesh_vert[first : first + count], np.float64))
        x, y, z, w = rotation.as_quat()
        return fitted, size, place, np.array([w, x, y, z])

    def shapes(self) -> list[Shape]:
        """The shapes where the bodies are now, world frame."""
        data = self._data
        mujoco.mj_kinematics(self._model, data)  # a step leaves places as they were before it
        found = []
        for geom, kind, size, place, turn in self._parts:
            own, whole = np.empty(4), np.empty(4)
            mujoco.mju_mat2Quat(own, data.geom_xmat[geom])
            mujoco.mju_mulQuat(whole, own, turn)
            position = data.geom_xpos[geom] + data.geom_xmat[geom].reshape(3, 3) @ place
            w, x, y, z = whole.tolist()
            orientation: Quaternion = IDENTITY if kind == "sphere" else (x, y, z, w)
            found.append(Shape(kind, vector3(position), size, orientation, self._surface))
        return found
