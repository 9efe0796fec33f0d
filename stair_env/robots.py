"""Legged robots as data: one more is one more RobotSpec, never a class.

All robots share one canonical convention, whatever their URDF does: legs in the order FR, FL, RR, RL; three joints a
leg (hip abduction about +x, upper and lower about +y of the base frame, zero = leg straight down, knee bent backwards
is negative). `joint_signs` and `joint_offsets` translate: urdf_angle = sign * canonical_angle + offset.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stair_env.common.field_kinds import naming_fields
from stair_env.common.transforms import look_along
from stair_env.common.validation import SpecError, check_choice, check_range
from stair_env.scene.shapes import IDENTITY, Quaternion, Vector3

LEGS = ("FR", "FL", "RR", "RL")
JOINTS_PER_LEG, NUM_JOINTS = 3, 12
LEG_SIDE = np.array([-1.0, 1.0, -1.0, 1.0])  # y sign of each leg


@dataclass(frozen=True)
class CameraMount:
    """Where the D435i sits on the trunk.

    Attributes:
        position: colour imager in the base frame, metres.
        pitch_down_rad: tilt of the optical axis below the base's x axis.
    """

    position: Vector3
    pitch_down_rad: float


@dataclass(frozen=True)
class RobotSpec:
    """What the simulation, the gait and the sensors need to know of a robot.

    Attributes:
        name: key in ROBOTS, or any other for a robot of one's own.
        urdf: path inside pybullet_data, or of a file of one's own.
        joint_names: (12,) URDF joints in canonical order.
        toe_names: (4,) names of the links that touch the ground, canonical leg order.
        hip_x, hip_y: (front, rear) x and the y magnitude of the abduction axes in the base frame, metres.
        hip_offset, upper_length, lower_length: leg link lengths to the centre of the foot, metres.
        foot_radius: metres.
        stand_height: base above the feet when standing, metres.
        max_torque: of each joint, N·m.
        mass: of the whole robot, kg (for cost of transport).
        camera: mount of the D435i.
        joint_signs, joint_offsets: (12,) translation to the URDF's angles.
        base_orientation: rotation from the URDF's base link to the canonical base frame, quaternion.
        kp, kd: gains of joints under PD control, N·m/rad and N·m·s/rad; 0 takes 5 times max_torque, and kp / 80.
        max_speed: of each joint, rad/s.
        rotor_inertia: of each motor as seen at its joint, kg·m² (models of such robots take 0.005 to 0.01).
    """

    name: str
    urdf: str
    joint_names: tuple[str, ...]
    toe_names: tuple[str, ...]
    hip_x: tuple[float, float]
    hip_y: float
    hip_offset: float
    upper_length: float
    lower_length: float
    foot_radius: float
    stand_height: float
    max_torque: float
    mass: float
    camera: CameraMount
    joint_signs: tuple[float, ...] = (1.0,) * NUM_JOINTS
    joint_offsets: tuple[float, ...] = (0.0,) * NUM_JOINTS
    base_orientation: Quaternion = IDENTITY
    kp: float = 0.0
    kd: float = 0.0
    max_speed: float = 20.0
    rotor_inertia: float = 0.01

    @naming_fields
    def __post_init__(self) -> None:
        object.__setattr__(self, "kp", self.kp or 5.0 * self.max_torque)
        object.__setattr__(self, "kd", self.kd or self.kp / 80.0)
        for name, length in (("joint_names", 12), ("toe_names", 4), ("joint_signs", 12), ("joint_offsets", 12)):
            if len(getattr(self, name)) != length:
                raise SpecError(f"{name} of robot {self.name!r} has {len(getattr(self, name))} entries, needs {length}")
        check_range("stand_height", self.stand_height, 0.05, self.upper_length + self.lower_length)

    @property
    def hips(self) -> np.ndarray:
        """(4, 3) abduction joints in the base frame, metres."""
        x_front, x_rear = self.hip_x
        return np.array([[x, side * self.hip_y, 0.0] for x, side in zip((x_front, x_front, x_rear, x_rear), LEG_SIDE)])

    @property
    def nominal_feet(self) -> np.ndarray:
        """(4, 3) foot centres in the base frame when standing on flat ground, metres."""
        feet = self.hips
        feet[:, 1] += LEG_SIDE * self.hip_offset
        feet[:, 2] = -self.stand_height
        return feet


def _unitree_joints() -> tuple[str, ...]:
    return tuple(f"{leg}_{part}_joint" for leg in LEGS for part in ("hip", "upper", "lower"))


def _unitree_toes() -> tuple[str, ...]:
    return tuple(f"{leg}_toe" for leg in LEGS)


# Link lengths and torques: the URDFs in pybullet_data. The AlienGo trunk's collision box reaches to x = 0.32 m; the
# camera sits on its front face. Its pitch shows everything from the horizon down to the ground 0.4 m ahead of the lens.
_ALIENGO = RobotSpec(
    name="aliengo",
    urdf="aliengo/aliengo.urdf",
    joint_names=_unitree_joints(),
    toe_names=_unitree_toes(),
    hip_x=(0.2399, -0.2399),
    hip_y=0.051,
    hip_offset=0.083,
    upper_length=0.25,
    lower_length=0.25,
    foot_radius=0.0265,
    stand_height=0.38,
    max_torque=44.4,
    mass=20.6,
    camera=CameraMount(position=(0.34, 0.0, 0.06), pitch_down_rad=0.40),
    kp=250.0,
    kd=3.0,
    max_speed=20.0,
)
_A1 = RobotSpec(
    name="a1",
    urdf="a1/a1.urdf",
    joint_names=_unitree_joints(),
    toe_names=_unitree_toes(),
    hip_x=(0.183, -0.183),
    hip_y=0.047,
    hip_offset=0.0838,
    upper_length=0.20,
    lower_length=0.20,
    foot_radius=0.02,
    stand_height=0.28,
    max_torque=33.5,
    mass=12.5,
    camera=CameraMount(position=(0.27, 0.0, 0.05), pitch_down_rad=0.40),
    kp=120.0,
    kd=1.5,
    max_speed=21.0,
)
# Laikago's URDF has z forward and y up, and zero angles with the thigh 0.599 rad behind the vertical and the shank
# 0.088 rad behind it. Its right abduction axes point backwards. Hip offsets: 0.0329 m right, 0.0352 m left; the mean.
_LAIKAGO = RobotSpec(
    name="laikago",
    urdf="laikago/laikago_toes.urdf",
    joint_names=tuple(
        f"{leg}_{joint}_joint"
        for leg in LEGS
        for joint in ("hip_motor_2_chassis", "upper_leg_2_hip_motor", "lower_leg_2_upper_leg")
    ),
    toe_names=tuple(f"toe{leg}" for leg in LEGS),
    hip_x=(0.2429, -0.1944),
    hip_y=0.0817,
    hip_offset=0.0340,
    upper_length=0.2522,
    lower_length=0.2510,
    foot_radius=0.03,
    stand_height=0.38,
    max_torque=100.0,
    mass=25.6,
    camera=CameraMount(position=(0.34, 0.0, 0.06), pitch_down_rad=0.40),
    joint_signs=(-1.0, 1.0, 1.0, 1.0, 1.0, 1.0) * 2,
    joint_offsets=(0.0, -0.5990, 0.5112) * 4,
    base_orientation=(-0.5, -0.5, -0.5, 0.5),
    kp=300.0,
    kd=4.0,
)
# The Mini Cheetah's URDF gives its motors no torque; 17 N·m is what its designer measured (Katz, Di Carlo and Kim,
# "Mini Cheetah", ICRA 2019). Thighs and knees turn about -y. The camera sits before the front hips.
_MINI_CHEETAH = RobotSpec(
    name="mini_cheetah",
    urdf="mini_cheetah/mini_cheetah.urdf",
    joint_names=tuple(
        joint.format(leg=leg)
        for leg in ("fr", "fl", "hr", "hl")
        for joint in ("torso_to_abduct_{leg}_j", "abduct_{leg}_to_thigh_{leg}_j", "thigh_{leg}_to_knee_{leg}_j")
    ),
    toe_names=("toe_fr", "toe_fl", "toe_hr", "toe_hl"),
    hip_x=(0.19, -0.19),
    hip_y=0.049,
    hip_offset=0.062,
    upper_length=0.209,
    lower_length=0.18,
    foot_radius=0.015,
    stand_height=0.27,
    max_torque=17.0,
    mass=8.9,
    camera=CameraMount(position=(0.24, 0.0, 0.04), pitch_down_rad=0.40),
    joint_signs=(1.0, -1.0, -1.0) * 4,
    kp=80.0,
    kd=1.0,
    max_speed=40.0,
)

DEFAULT_ROBOT = "aliengo"
ROBOTS: dict[str, RobotSpec] = {robot.name: robot for robot in (_ALIENGO, _A1, _LAIKAGO, _MINI_CHEETAH)}


def get_robot(robot: str | RobotSpec) -> RobotSpec:
    """Return the robot of a name; a RobotSpec is returned as it is.

    Raises:
        SpecError: the name is unknown, the message lists the choices; or a RobotSpec's URDF is not there.
    """
    if isinstance(robot, RobotSpec):
        find_urdf(robot)
        return robot
    if not isinstance(robot, str):
        raise SpecError(f"robot={robot!r} must be a RobotSpec or one of {', '.join(map(repr, ROBOTS))}")
    check_choice("robot", robot, tuple(ROBOTS))
    return ROBOTS[robot]


def find_urdf(robot: RobotSpec) -> str:
    """Return the path of a robot's URDF: as it stands if there is such a file, else inside pybullet_data.

    Raises:
        SpecError: there is no such file in either place.
    """
    import pybullet_data

    data = Path(pybullet_data.getDataPath())
    if (data / robot.urdf).is_file():  # an absolute path stays as it is
        return robot.urdf
    own = Path(robot.urdf).resolve()
    if own.is_file():
        return str(own)
    raise SpecError(f"urdf={robot.urdf!r} of robot {robot.name!r} is no file, neither here nor in {data}")


def mount_to_base(mount: CameraMount) -> np.ndarray:
    """(4, 4) camera_to_base of a mount: optical axes x right, y down, z forward."""
    return look_along(np.asarray(mount.position), 0.0, mount.pitch_down_rad)


def per_joint(name: str, value: Any, low: float, high: float) -> np.ndarray:
    """Read a number, three (hip, upper, lower) or twelve as (12,) float64.

    Raises:
        SpecError: another count, or one out of [low, high].
    """
    numbers = list(value) if isinstance(value, list | tuple | np.ndarray) else [value]
    if len(numbers) not in (1, JOINTS_PER_LEG, NUM_JOINTS):
        raise SpecError(f"{name}={value!r} must be one number, three (hip, upper, lower) or twelve")
    for number in numbers:
        check_range(name, number, low, high)
    return np.tile(np.array(numbers, np.float64), NUM_JOINTS // len(numbers))
