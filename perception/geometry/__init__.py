"""From lines and depth to steps."""

from stair_env.common.moved import moved_names

__getattr__ = moved_names(
    __name__,
    (
        "GRAVITY_STD_RAD",
        "OMEGA_M",
        "Geometry",
        "attitude_angles",
        "camera_to_level",
        "level_to_stair",
        "line_normals",
        "measure_stairs",
        "yaw_from_lines",
    ),
    "perception.geometry.planes",
)
