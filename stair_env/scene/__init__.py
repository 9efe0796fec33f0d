"""Staircases and what stands around them: solids, materials, light, random draws."""

from stair_env.common.moved import moved_names

__getattr__ = moved_names(
    __name__,
    ("IDENTITY", "Quaternion", "Shape", "ShapeKind", "Vector3", "box_between", "build_stair_shapes", "vector3"),
    "stair_env.scene.shapes",
)
