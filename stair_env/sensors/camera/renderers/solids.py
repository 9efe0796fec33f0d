"""Shapes as arrays, the form the compiled renderer reads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from stair_env.common.validation import check_choice
from stair_env.scene.shapes import Shape

KINDS: tuple[str, ...] = ("box", "sphere", "cylinder", "capsule")  # in the order of the kernels' numbers


@dataclass(frozen=True)
class Solids:
    """n solids in the world frame.

    Attributes:
        kinds: (n,) int32, index into KINDS.
        sizes: (n, 3) float32, as `Shape.size`, metres.
        bounds: (n, 3) float32, half extents of the bounding box in the solid's own frame, metres.
        rotations: (n, 3, 3) float64, local to world.
        centres: (n, 3) float64, metres.
    """

    kinds: np.ndarray
    sizes: np.ndarray
    bounds: np.ndarray
    rotations: np.ndarray
    centres: np.ndarray

    @classmethod
    def from_shapes(cls, shapes: Sequence[Shape]) -> Solids:
        """Pack shapes.

        Raises:
            SpecError: a shape's kind is none of KINDS.
        """
        n = len(shapes)
        for shape in shapes:
            check_choice("kind", shape.kind, KINDS)
        kinds = np.array([KINDS.index(shape.kind) for shape in shapes], dtype=np.int32)
        sizes = np.array([shape.size for shape in shapes], dtype=np.float32).reshape(n, 3)
        centres = np.array([shape.position for shape in shapes], dtype=np.float64).reshape(n, 3)
        quaternions = np.array([shape.orientation for shape in shapes], dtype=np.float64).reshape(n, 4)
        rotations = Rotation.from_quat(quaternions).as_matrix() if n else np.zeros((0, 3, 3))
        return cls(kinds, sizes, _local_bounds(kinds, sizes), np.ascontiguousarray(rotations), centres)

    def joined(self, other: Solids) -> Solids:
        """These solids, then the other ones."""
        names = ("kinds", "sizes", "bounds", "rotations", "centres")
        return Solids(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in names))


def _local_bounds(kinds: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """(n, 3) float32 half extents from (n,) kinds and (n, 3) sizes."""
    radius, half = sizes[:, 0], sizes[:, 1]
    box, sphere, capsule = (kinds == KINDS.index(name) for name in ("box", "sphere", "capsule"))
    length = np.where(sphere, radius, half + np.where(capsule, radius, 0.0))
    round_bounds = np.stack([radius, radius, length], axis=-1)
    return np.where(box[:, None], sizes, round_bounds).astype(np.float32)
