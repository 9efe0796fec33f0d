"""The physics in MuJoCo (`stair-env[mujoco]`): the same questions as `stair_env.physics.simulation`, another engine."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np

from stair_env.common.constants import CONTROL_DT, PHYSICS_RATE_HZ
from stair_env.physics.body_kernels import READING_WIDTH, TRACK_WIDTH, trace_trunk
from stair_env.physics.body_state import BaseState, BaseTrack, FootContacts, RobotReading
from stair_env.physics.display import display_problem
from stair_env.physics.interface import LEAST_TRUNK_MASS_KG, TOUCH_N, MovingSolids
from stair_env.physics.mujoco_model import TIMESTEP_S, build_model, read_robot
from stair_env.physics.mujoco_motors import ConstraintMotors
from stair_env.physics.mujoco_shapes import GeomShapes
from stair_env.robots import NUM_JOINTS, RobotSpec
from stair_env.scene.shapes import Shape

STEPS = round(1.0 / (PHYSICS_RATE_HZ * TIMESTEP_S))  # of MuJoCo in one of ours
TRUNK = 1  # MuJoCo's number of the first body after the world

_LOGGER = logging.getLogger(__name__)


class MujocoSimulation:
    """A robot among solids.

    Args:
        robot: which robot.
        gui: open MuJoCo's window instead of running headless.

    Raises:
        SpecError: MuJoCo cannot read the robot's URDF.
    """

    client = None

    def __init__(self, robot: RobotSpec, gui: bool = False) -> None:
        self.robot = robot
        problem = display_problem() if gui else None
        self._gui = gui and problem is None
        if problem is not None:
            _LOGGER.warning("no display (%s): the simulation runs without a window", problem)
        self._viewer: Any = None
        self._robot_spec = read_robot(robot)
        self._signs, self._offsets = np.array(robot.joint_signs), np.array(robot.joint_offsets)
        x, y, z, w = robot.base_orientation
        self._link_to_base = np.array([w, -x, -y, -z])  # w, x, y, z
        canonical = np.empty(9)
        mujoco.mju_quat2Mat(canonical, np.array([w, x, y, z]))
        self._canonical = canonical.reshape(3, 3)
        self._last_targets, self._last_row = np.zeros(NUM_JOINTS), np.zeros(TRACK_WIDTH)

    def close(self) -> None:
        """Close the window, where there is one; safe to call twice."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    # ------------------------------------------------------------------ an episode's world

    def build(self, shapes: Sequence[Shape], friction: float) -> None:
        """Start a world, see `stair_env.physics.interface.Physics`; it takes about 2 ms."""
        robot = self.robot
        self.close()
        self.model = model = build_model(self._robot_spec, robot.toe_names, shapes, friction)
        self.data = mujoco.MjData(model)
        joints = [model.joint(name).id for name in robot.joint_names]
        self._angles, self._rates = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self._toes = [model.body(name).id for name in robot.toe_names]
        self._foot_of_body = {body: foot for foot, body in enumerate(self._toes)}
        self._base_mass = float(model.body_mass[TRUNK])
        self._motors = ConstraintMotors(model, self.data, self._rates)
        self._applied: np.ndarray | None = None  # canonical torques of the last step, where they drive the joints
        if self._gui:
            from mujoco import viewer  # loads OpenGL

            self._viewer = viewer.launch_passive(model, self.data, show_left_ui=False, show_right_ui=False)

    def set_payload(self, kilograms: float) -> None:
        """Add mass to the trunk (negative takes some away); its inertia grows in proportion, as in Bullet."""
        mass = max(LEAST_TRUNK_MASS_KG, self._base_mass + kilograms)
        self.model.body_inertia[TRUNK] *= mass / self.model.body_mass[TRUNK]
        self.model.body_mass[TRUNK] = mass
        self._derive_constants()

    def add_rotor_inertia(self, rotor_inertia: np.ndarray) -> None:
        """Give joints the inertia (12,) kg·m² of their motors: MuJoCo's armature."""
        self.model.dof_armature[self._rates] = rotor_inertia
        self._derive_constants()

    def _derive_constants(self) -> None:
        """Let MuJoCo work out anew what follows from masses, in data of its own: it leaves the robot at its zeros."""
        mujoco.mj_setConst(self.model, mujoco.MjData(self.model))

    def place_robot(self, position: np.ndarray, yaw: float, joint_angles: np.ndarray, pitch: float = 0.0) -> None:
        """Teleport the robot, at rest; see `stair_env.physics.interface.Physics`."""
        data = self.data
        mujoco.mj_resetData(self.model, data)
        turn, tip, heading, link = (np.empty(4) for _ in range(4))
        mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), yaw)
        mujoco.mju_axisAngle2Quat(tip, np.array([0.0, 1.0, 0.0]), pitch)
        mujoco.mju_mulQuat(heading, turn, tip)
        mujoco.mju_mulQuat(link, heading, self._link_to_base)
        data.qpos[:3], data.qpos[3:7] = position, link
        data.qpos[self._angles] = self._to_urdf(joint_angles)
        self._last_targets, self._applied = np.array(joint_angles, np.float64), None
        mujoco.mj_forward(self.model, data)
        self.begin_track()

    def _to_urdf(self, angles: np.ndarray) -> np.ndarray:
        return self._signs * angles + self._offsets

    def push(self, velocity: np.ndarray) -> None:
        """Add a velocity (3,) m/s to the trunk at once, as a shove does."""
        self.data.qvel[:3] += velocity

    # ------------------------------------------------------------------ motion

    def command_joints(self, joint_angles: np.ndarray, strength: float = 1.0) -> None:
        """Set the motors' targets for a control step, see `stair_env.physics.interface.Physics`."""
        velocities = (joint_angles - self._last_targets) / CONTROL_DT
        self._last_targets, self._applied = np.array(joint_angles, np.float64), None
        limit = strength * self.robot.max_torque
        self._motors.command(self._to_urdf(joint_angles), self._signs * velocities, limit)

    def release_joints(self) -> None:
        """Switch the motors off; from here on torques move the joints."""
        self._motors.release()
        self._applied = np.zeros(NUM_JOINTS)

    def step_physics(self) -> None:
        """Advance one physics step of 1/240 s."""
        for _ in range(STEPS):
            self._motors.step()

    def step_and_track(self, steps: int) -> BaseTrack:
        """Advance some physics steps and tell how the trunk moved since the last track."""
        readings: list[float] = []
        for _ in range(steps):
            self.step_physics()
            readings += self._read_trunk()
        return self._tracked(readings)

    def step_under_torques(self, torques: Callable[[np.ndarray, np.ndarray], np.ndarray], steps: int) -> BaseTrack:
        """Advance under torques that are computed anew before each physics step, and held through it."""
        readings: list[float] = []
        data, signs = self.data, self._signs
        for _ in range(steps):
            angles = signs * (data.qpos[self._angles] - self._offsets)
            self._applied = torques(angles, signs * data.qvel[self._rates])
            data.qfrc_applied[self._rates] = signs * self._applied
            mujoco.mj_step(self.model, data, STEPS)
            readings += self._read_trunk()
        return self._tracked(readings)

    # ------------------------------------------------------------------ what can be known

    def begin_track(self) -> BaseTrack:
        """Where the trunk is now, without motion; the next track continues from here."""
        self._last_row = self._trace(self._read_trunk())[0]
        return BaseTrack(self._last_row, np.empty((0, TRACK_WIDTH)))

    def _tracked(self, readings: Sequence[float]) -> BaseTrack:
        track = BaseTrack(self._last_row, self._trace(readings))
        self._last_row = track.rows[-1]
        return track

    def _read_trunk(self) -> list[float]:
        """Position, quaternion (x, y, z, w), linear and angular velocity of the root link, world frame."""
        pose, velocity, spin = self.data.qpos[:7], self.data.qvel[:6], np.empty(3)
        mujoco.mju_rotVecQuat(spin, velocity[3:], pose[3:])  # MuJoCo tells it in the link's axes
        x, y, z, qw, qx, qy, qz = pose.tolist()
        return [x, y, z, qx, qy, qz, qw, *velocity[:3].tolist(), *spin.tolist()]

    def _trace(self, readings: Sequence[float]) -> np.ndarray:
        """(k, 18) rows of a track; the free joint's origin is the base's."""
        traced: np.ndarray = trace_trunk(np.array(readings).reshape(-1, READING_WIDTH), self._canonical, np.zeros(3))
        return traced

    def base_state(self) -> BaseState:
        """Pose and velocity of the canonical base frame."""
        rows = self._trace(self._read_trunk())
        return BaseTrack(rows[0], rows).last

    def read_robot(self) -> RobotReading:
        """Joints, contacts and feet now."""
        return RobotReading(*self.joint_states(), self.foot_contacts(), self.foot_positions())

    def joint_states(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Canonical angles (12,) rad, velocities (12,) rad/s, and motor torques (12,) N·m of the last step."""
        angles = self._signs * (self.data.qpos[self._angles] - self._offsets)
        torques = self._signs * self._motors.torques if self._applied is None else np.array(self._applied)
        return angles, self._signs * self.data.qvel[self._rates], torques

    def foot_positions(self) -> np.ndarray:
        """(4, 3) foot centres in the world frame, metres."""
        mujoco.mj_kinematics(self.model, self.data)  # a step leaves places as they were before it
        return self.data.xpos[self._toes].copy()

    def foot_contacts(self) -> FootContacts:
        """Contacts of the last step of MuJoCo."""
        data, bodies = self.data, self.model.geom_bodyid
        touching, force, body_touches = np.zeros(4, bool), np.zeros((4, 3)), False
        parts = np.empty(6)
        for number in range(data.ncon):
            contact = data.contact[number]
            first, second = bodies[contact.geom[0]], bodies[contact.geom[1]]
            robot, sign = (second, 1.0) if first == 0 else (first, -1.0)  # forces act on the second geometry
            mujoco.mj_contactForce(self.model, data, number, parts)
            foot = self._foot_of_body.get(int(robot))
            if foot is None:
                body_touches = body_touches or bool(parts[0] > TOUCH_N)
                continue
            touching[foot] = True
            force[foot] += sign * (contact.frame.reshape(3, 3).T @ parts[:3])
        return FootContacts(touching, force, body_touches)

    def solids(self) -> MovingSolids:
        """The robot's collision shapes, good until the next world is built."""
        return GeomShapes(self.model, self.data)

    def follow_with_camera(self, position: np.ndarray, yaw_deg: float = 50.0) -> None:
        """Keep MuJoCo's window on the robot, where there is one."""
        if self._viewer is not None and self._viewer.is_running():
            camera = self._viewer.cam
            camera.lookat[:], camera.distance, camera.azimuth, camera.elevation = position, 1.8, yaw_deg, -20.0
            self._viewer.sync()
