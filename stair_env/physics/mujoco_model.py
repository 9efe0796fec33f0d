"""A robot's URDF and a scene's solids as a MuJoCo model.

MuJoCo reads the URDF itself. What is drawn is left out, collision shapes stay; links keep their names, and the root
gets a free joint. Meshes, where a robot collides with them, are looked for beside the URDF.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from stair_env.common.constants import GRAVITY_M_S2
from stair_env.common.validation import SpecError, check_choice
from stair_env.physics.interface import DEFAULT_COLOUR, FOOT_FRICTION, LINK_FRICTION, SHAPE_COLOURS
from stair_env.robots import RobotSpec, find_urdf
from stair_env.scene.shapes import Shape

TIMESTEP_S = 1.0 / 480.0  # near MuJoCo's own 2 ms; contacts are as soft as MuJoCo has them unless told
SLIP_STIFFNESS = 10.0  # impratio: of friction against the normal direction, so that a standing foot does not creep
TORSION, ROLLING = 0.005, 0.0001  # MuJoCo's defaults; of no effect where contacts have three dimensions
# A motor's constraint is as hard as MuJoCo makes one.
MOTOR_SOLIMP = (0.9999, 0.9999, 0.001, 0.5, 2.0)
LEAST_INERTIA = 1e-9  # kg·m² per kg: less is a URDF that leaves inertias to the engine
KINDS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
}
# Bits by which geometries meet: the robot meets the ground, and neither meets itself, as in Bullet.
ROBOT_MEETS, GROUND_MEETS = (1, 0), (0, 1)


def read_robot(robot: RobotSpec) -> Any:
    """The robot alone, as an `mujoco.MjSpec` with a motor (an equality constraint, not active) at each joint.

    Raises:
        SpecError: MuJoCo cannot read the URDF, or a joint or toe is not in it.
    """
    try:
        spec = mujoco.MjSpec.from_string(_collision_urdf(robot))
        if (root := spec.worldbody.first_body()) is None:
            raise ValueError("it has no link")
        root.add_freejoint()
        _fill_inertias(spec)
        spec.copy().compile()
    except (ValueError, OSError, ElementTree.ParseError) as error:
        raise SpecError(f"urdf={robot.urdf!r} of robot {robot.name!r}: MuJoCo says {error}") from None
    joints, links = tuple(joint.name for joint in spec.joints), tuple(body.name for body in spec.bodies)
    for name in robot.joint_names:
        check_choice(f"joint_names of robot {robot.name!r}", name, joints)
    for name in robot.toe_names:
        check_choice(f"toe_names of robot {robot.name!r}", name, links)
    for name in robot.joint_names:
        spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=name, active=False, solimp=MOTOR_SOLIMP)
    option = spec.option
    option.timestep, option.gravity = TIMESTEP_S, (0.0, 0.0, -GRAVITY_M_S2)
    option.integrator, option.cone = mujoco.mjtIntegrator.mjINT_IMPLICITFAST, mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = SLIP_STIFFNESS
    return spec


def _collision_urdf(robot: RobotSpec) -> str:
    """The URDF without what is only drawn, and with MuJoCo's settings for reading it."""
    path = Path(find_urdf(robot))
    if not path.is_absolute():
        import pybullet_data

        path = Path(pybullet_data.getDataPath()) / path
    root = ElementTree.parse(path).getroot()
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for own in root.findall("mujoco"):
        root.remove(own)
    settings = {"fusestatic": "false", "strippath": "false", "meshdir": str(path.parent), "balanceinertia": "true"}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", settings)
    return ElementTree.tostring(root, encoding="unicode")


def _fill_inertias(spec: Any) -> None:
    """Give links whose inertia the URDF leaves out that of the box around their collision shapes, as Bullet does."""
    hollow = [body for body in spec.bodies if body.mass > 0.0 and _moment(body) < LEAST_INERTIA * body.mass]
    if not hollow:
        return
    for body in hollow:
        body.fullinertia = np.full(6, np.nan)
        body.inertia = np.full(3, body.mass)  # of any size, so that there is a model to measure
    model = spec.copy().compile()
    for body in hollow:
        body.inertia = box_inertia(model, body.name, body.mass)
        body.iquat = (1.0, 0.0, 0.0, 0.0)


def _moment(body: Any) -> float:
    """The largest moment of inertia that is given, kg·m²."""
    return float(np.nanmax(np.abs(np.concatenate([body.inertia, body.fullinertia]))))


def box_inertia(model: Any, body: str, mass: float) -> np.ndarray:
    """(3,) moments of inertia, kg·m², of the box around a body's collision shapes, along the body's axes."""
    number = model.body(body).id
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for geom in np.flatnonzero(model.geom_bodyid == number):
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        turn = rotation.reshape(3, 3)
        middle = model.geom_pos[geom] + turn @ model.geom_aabb[geom, :3]
        reach = np.abs(turn) @ model.geom_aabb[geom, 3:]
        low, high = np.minimum(low, middle - reach), np.maximum(high, middle + reach)
    squares = (high - low) ** 2 if np.isfinite(low).all() else np.zeros(3)
    moments: np.ndarray = mass / 12.0 * (squares.sum() - squares)
    return moments


def build_model(robot_spec: Any, toes: Sequence[str], shapes: Sequence[Shape], friction: float) -> Any:
    """Put a robot among solids.

    Args:
        robot_spec: of `read_robot`; stays as it is.
        toes: names of the links that are feet.
        shapes: of the scene; those that do not collide are left out.
        friction: of the ground against the feet. MuJoCo takes one of two geometries' coefficients where Bullet takes
            their product, so the robot's geometries hold the product, and theirs count.

    Returns:
        The `mujoco.MjModel`.
    """
    spec = robot_spec.copy()
    for geom in spec.geoms:
        own = FOOT_FRICTION if geom.parent.name in toes else LINK_FRICTION
        geom.priority, geom.friction = 1, (own * friction, TORSION, ROLLING)
        geom.contype, geom.conaffinity = ROBOT_MEETS
        geom.condim = 3
    for shape in shapes:
        if not shape.collides:
            continue
        x, y, z, w = shape.orientation
        contype, conaffinity = GROUND_MEETS
        spec.worldbody.add_geom(
            type=KINDS[shape.kind],
            size=shape.size,
            pos=shape.position,
            quat=(w, x, y, z),
            rgba=SHAPE_COLOURS.get(shape.surface, DEFAULT_COLOUR),
            contype=contype,
            conaffinity=conaffinity,
        )
    return spec.compile()
