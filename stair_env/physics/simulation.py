"""The physics in Bullet: the one owner of a Bullet client.

It answers named questions about the robot in canonical terms (see `stair_env.robots`) and hides Bullet's link
indices, inertial frames and joint conventions.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pybullet
import pybullet_data
from pybullet_utils.bullet_client import BulletClient

from stair_env.common.constants import CONTROL_DT as CONTROL_DT
from stair_env.common.constants import CONTROL_RATE_HZ as CONTROL_RATE_HZ
from stair_env.common.constants import GRAVITY_M_S2
from stair_env.common.constants import PHYSICS_RATE_HZ as PHYSICS_RATE_HZ
from stair_env.common.constants import SUBSTEPS as SUBSTEPS
from stair_env.common.validation import SpecError, check_choice
from stair_env.physics.body_kernels import READING_WIDTH, TRACK_WIDTH, trace_trunk
from stair_env.physics.body_state import BaseState as BaseState
from stair_env.physics.body_state import BaseTrack as BaseTrack
from stair_env.physics.body_state import FootContacts as FootContacts
from stair_env.physics.body_state import RobotReading as RobotReading
from stair_env.physics.body_state import base_to_world as base_to_world
from stair_env.physics.bullet_client import QuietBulletClient
from stair_env.physics.display import display_problem
from stair_env.physics.interface import (
    DEFAULT_COLOUR,
    LEAST_TRUNK_MASS_KG,
    LINK_FRICTION,
    POSITION_GAIN,
    TOUCH_N,
    VELOCITY_GAIN,
    MovingSolids,
)
from stair_env.physics.interface import FOOT_FRICTION as FOOT_FRICTION
from stair_env.physics.interface import SHAPE_COLOURS as SHAPE_COLOURS
from stair_env.robots import NUM_JOINTS, RobotSpec, find_urdf
from stair_env.scene.shapes import Shape

POSITION_GAINS, VELOCITY_GAINS = [POSITION_GAIN] * NUM_JOINTS, [VELOCITY_GAIN] * NUM_JOINTS

_LOGGER = logging.getLogger(__name__)


class Simulation:
    """A robot among solids.

    Args:
        robot: which robot.
        gui: open Bullet's window instead of running headless.
        visible: load what Bullet's own renderers draw. Without it an episode begins four times sooner, and the
            ray-caster, which looks at collision shapes, sees as much.
    """

    def __init__(self, robot: RobotSpec, gui: bool = False, visible: bool = True) -> None:
        self.robot = robot
        problem = display_problem() if gui else None
        self._gui = gui and problem is None
        if problem is not None:
            _LOGGER.warning("no display (%s): the simulation runs without a window", problem)
        self._visible = visible or self._gui
        self.client: BulletClient = QuietBulletClient(pybullet.GUI if self._gui else pybullet.DIRECT)
        self.body = -1
        self.ground: list[int] = []
        self._last_targets = np.zeros(NUM_JOINTS)
        self._applied: np.ndarray | None = (
            None  # torques of the last physics step, where they and no motors drive joints
        )
        self._last_row = np.zeros(TRACK_WIDTH)  # of the trunk, where the next track begins
        self._signs = np.array(robot.joint_signs)
        self._offsets = np.array(robot.joint_offsets)
        # What Bullet calls zero, of angles, velocities and torques.
        self._joint_zeros = np.array([self._offsets, np.zeros(NUM_JOINTS), np.zeros(NUM_JOINTS)])

    def close(self) -> None:
        """Disconnect; safe to call twice."""
        if self.client is not None and self.client._client >= 0:
            self.client.disconnect()
            self.client._client = -1

    def build(self, shapes: Sequence[Shape], friction: float) -> None:
        """Start an empty world, put the solids in and load the robot far above them.

        A fresh world costs 5 ms an episode (20 ms if it is visible) and is what makes an episode independent of those
        before it. A robot whose collision shapes are meshes costs more: 25 ms for Laikago, 280 ms for Mini Cheetah.

        Args:
            shapes: solids of the scene; the ones that do not collide are drawn only.
            friction: lateral friction coefficient of the ground against the feet.
        """
        client = self.client
        client.resetSimulation()
        self._applied = None
        client.setAdditionalSearchPath(pybullet_data.getDataPath())
        client.setGravity(0, 0, -GRAVITY_M_S2)
        client.setTimeStep(1.0 / PHYSICS_RATE_HZ)
        client.setPhysicsEngineParameter(deterministicOverlappingPairs=1)
        self.ground = [self._add_shape(shape, friction) for shape in shapes]
        drawn = pybullet.URDF_ENABLE_CACHED_GRAPHICS_SHAPES if self._visible else pybullet.URDF_IGNORE_VISUAL_SHAPES
        try:
            self.body = client.loadURDF(find_urdf(self.robot), [0.0, 0.0, 5.0], flags=drawn)
        except pybullet.error as error:
            raise SpecError(f"urdf={self.robot.urdf!r} of robot {self.robot.name!r}: {error}") from None
        self._bind_calls()
        self._index_links()
        # Damping belongs to the body: PyBullet applies a call that names it to link -1, its friction included.
        client.changeDynamics(self.body, -1, linearDamping=0.0, angularDamping=0.0)
        for link in range(-1, client.getNumJoints(self.body)):
            friction_here = FOOT_FRICTION if link in self._foot_of_link else LINK_FRICTION
            client.changeDynamics(self.body, link, lateralFriction=friction_here)

    def _bind_calls(self) -> None:
        """Look up once what every control step calls: `BulletClient` wraps a function anew at each access."""
        client = self.client
        self._step_simulation: Callable[[], None] = client.stepSimulation
        self._base_pose, self._base_velocity = client.getBasePositionAndOrientation, client.getBaseVelocity
        self._set_motors = client.setJointMotorControlArray
        self._joint_states, self._link_states = client.getJointStates, client.getLinkStates
        self._contact_points = client.getContactPoints

    def _index_links(self) -> None:
        client, robot = self.client, self.robot
        infos = [client.getJointInfo(self.body, j) for j in range(client.getNumJoints(self.body))]
        joint_of = {info[1].decode(): info[0] for info in infos}
        link_of = {info[12].decode(): info[0] for info in infos}
        for name in robot.joint_names:
            check_choice(f"joint_names of robot {robot.name!r}", name, tuple(joint_of))
        for name in robot.toe_names:
            check_choice(f"toe_names of robot {robot.name!r}", name, tuple(link_of))
        self._joints = [joint_of[name] for name in robot.joint_names]
        toes = [link_of[name] for name in robot.toe_names]
        self._foot_of_link = {link: foot for foot, link in enumerate(toes)}
        self._toes = toes
        dynamics = client.getDynamicsInfo(self.body, -1)
        self._base_mass = float(dynamics[0])
        self._inertial_to_link: tuple[Sequence[float], Sequence[float]] = dynamics[3], dynamics[4]
        inertial = np.array(client.getMatrixFromQuaternion(dynamics[4])).reshape(3, 3)
        canonical = np.array(client.getMatrixFromQuaternion(robot.base_orientation)).reshape(3, 3)
        self._inertial_to_canonical = inertial.T @ canonical
        self._origin_in_base = -canonical.T @ np.array(dynamics[3])  # from the centre of mass, base axes, metres

    def _add_shape(self, shape: Shape, friction: float) -> int:
        client = self.client
        kinds: dict[str, tuple[int, dict[str, Any]]] = {
            "box": (pybullet.GEOM_BOX, {"halfExtents": shape.size}),
            "sphere": (pybullet.GEOM_SPHERE, {"radius": shape.size[0]}),
            "cylinder": (pybullet.GEOM_CYLINDER, {"radius": shape.size[0], "height": 2 * shape.size[1]}),
            "capsule": (pybullet.GEOM_CAPSULE, {"radius": shape.size[0], "height": 2 * shape.size[1]}),
        }
        geometry, size = kinds[shape.kind]
        collision = client.createCollisionShape(geometry, **size) if shape.collides else -1
        visual = -1
        if self._visible:
            visual_size = {("length" if key == "height" else key): value for key, value in size.items()}
            colour = SHAPE_COLOURS.get(shape.surface, DEFAULT_COLOUR)
            visual = client.createVisualShape(geometry, rgbaColor=colour, **visual_size)
        body = client.createMultiBody(0, collision, visual, shape.position, shape.orientation)
        client.changeDynamics(body, -1, lateralFriction=friction)
        return body

    def place_robot(self, position: np.ndarray, yaw: float, joint_angles: np.ndarray, pitch: float = 0.0) -> None:
        """Teleport the robot, at rest.

        Args:
            position: (3,) base origin, world frame, metres.
            yaw: heading, radians.
            joint_angles: (12,) canonical, radians.
            pitch: nose-down angle about the base's y axis, radians.
        """
        heading = pybullet.getQuaternionFromEuler([0, pitch, yaw])
        link_to_base = pybullet.invertTransform([0, 0, 0], self.robot.base_orientation)
        link_to_world = pybullet.multiplyTransforms(position, heading, *link_to_base)
        inertial_to_world = pybullet.multiplyTransforms(*link_to_world, *self._inertial_to_link)
        self.client.resetBasePositionAndOrientation(self.body, *inertial_to_world)  # it takes the inertial frame
        self.client.resetBaseVelocity(self.body, [0, 0, 0], [0, 0, 0])
        self._last_targets = joint_angles
        for joint, angle in zip(self._joints, self._to_urdf(joint_angles)):
            self.client.resetJointState(self.body, joint, angle, 0.0)
        self.begin_track()

    def _to_urdf(self, angles: np.ndarray) -> np.ndarray:
        return self._signs * angles + self._offsets

    def set_payload(self, kilograms: float) -> None:
        """Add mass to the trunk (negative takes some away)."""
        self.client.changeDynamics(self.body, -1, mass=max(LEAST_TRUNK_MASS_KG, self._base_mass + kilograms))

    def command_joints(self, joint_angles: np.ndarray, strength: float = 1.0) -> None:
        """Set the motors' targets for a control step.

        The velocity that leads from the last targets to these is fed forward. Without it a motor rushes to each
        target and waits there, 48 times a second, and the feet chatter on the ground and slip.

        Args:
            joint_angles: (12,) canonical, radians.
            strength: factor on the largest torque.
        """
        velocities = (joint_angles - self._last_targets) / CONTROL_DT
        self._last_targets = joint_angles
        self._set_motors(
            self.body,
            self._joints,
            pybullet.POSITION_CONTROL,
            targetPositions=self._to_urdf(joint_angles).tolist(),
            targetVelocities=(self._signs * velocities).tolist(),
            positionGains=POSITION_GAINS,
            velocityGains=VELOCITY_GAINS,
            forces=[strength * self.robot.max_torque] * NUM_JOINTS,
        )

    def add_rotor_inertia(self, rotor_inertia: np.ndarray) -> None:
        """Make joints as heavy to speed up as motors behind their gears are; a fresh world has forgotten it.

        Bullet knows no armature: the links that the joints move get the inertia, about the joints' axes.

        Args:
            rotor_inertia: (12,) as seen at the joints, kg·m².
        """
        for joint, inertia in zip(self._joints, rotor_inertia):
            dynamics, axis = (
                self.client.getDynamicsInfo(self.body, joint),
                self.client.getJointInfo(self.body, joint)[13],
            )
            principal = np.array(self.client.getMatrixFromQuaternion(dynamics[4])).reshape(3, 3).T @ np.array(axis)
            diagonal = np.array(dynamics[2]) + inertia * principal**2
            self.client.changeDynamics(self.body, joint, localInertiaDiagonal=diagonal.tolist())

    def release_joints(self) -> None:
        """Switch Bullet's motors off, which brake joints unless told; from here on torques move them."""
        self._set_motors(self.body, self._joints, pybullet.VELOCITY_CONTROL, forces=[0.0] * NUM_JOINTS)
        self._applied = np.zeros(NUM_JOINTS)

    def step_under_torques(self, torques: Callable[[np.ndarray, np.ndarray], np.ndarray], steps: int) -> BaseTrack:
        """Advance some physics steps under torques that are computed anew before each.

        Args:
            torques: of canonical angles (12,) rad and velocities (12,) rad/s: canonical torques (12,) N·m.
            steps: of 1/240 s.
        """
        readings: list[float] = []
        signs, zeros = self._signs, self._joint_zeros[:2]
        for _ in range(steps):
            angles, velocities, _, _ = zip(*self._joint_states(self.body, self._joints))
            angles, velocities = signs * (np.array([angles, velocities]) - zeros)
            self._applied = torques(angles, velocities)
            forces = (signs * self._applied).tolist()
            self._set_motors(self.body, self._joints, pybullet.TORQUE_CONTROL, forces=forces)
            self._step_simulation()
            readings += self._read_trunk()
        return self._tracked(readings)

    def step_physics(self) -> None:
        """Advance one physics step of 1/240 s."""
        self._step_simulation()

    def step_and_track(self, steps: int) -> BaseTrack:
        """Advance some physics steps and tell how the trunk moved since the last track."""
        readings: list[float] = []
        for _ in range(steps):
            self._step_simulation()
            readings += self._read_trunk()
        return self._tracked(readings)

    def _tracked(self, readings: Sequence[float]) -> BaseTrack:
        """The track of some readings of the trunk; the next one continues from here."""
        track = BaseTrack(self._last_row, self._trace(readings))
        self._last_row = track.rows[-1]
        return track

    def begin_track(self) -> BaseTrack:
        """Where the trunk is now, without motion; the next track continues from here."""
        self._last_row = self._trace(self._read_trunk())[0]
        return BaseTrack(self._last_row, np.empty((0, TRACK_WIDTH)))

    def _read_trunk(self) -> tuple[float, ...]:
        """Position, quaternion, linear and angular velocity of Bullet's inertial frame: thirteen numbers."""
        position, quaternion = self._base_pose(self.body)
        linear, angular = self._base_velocity(self.body)
        return (*position, *quaternion, *linear, *angular)

    def _trace(self, readings: Sequence[float]) -> np.ndarray:
        """(k, 18) rows of a track."""
        rows = np.array(readings).reshape(-1, READING_WIDTH)
        traced: np.ndarray = trace_trunk(rows, self._inertial_to_canonical, self._origin_in_base)
        return traced

    def push(self, velocity: np.ndarray) -> None:
        """Add a velocity (3,) m/s to the trunk at once, as a shove does."""
        linear, angular = self.client.getBaseVelocity(self.body)
        self.client.resetBaseVelocity(self.body, np.add(linear, velocity), angular)

    def base_state(self) -> BaseState:
        """Pose and velocity of the canonical base frame."""
        rows = self._trace(self._read_trunk())
        return BaseTrack(rows[0], rows).last

    def read_robot(self) -> RobotReading:
        """Joints, contacts and feet now."""
        return RobotReading(*self.joint_states(), self.foot_contacts(), self.foot_positions())

    def joint_states(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Canonical angles (12,) rad, velocities (12,) rad/s, and motor torques (12,) N·m of the last step."""
        angles, velocities, _, torques = zip(*self._joint_states(self.body, self._joints))
        angles, velocities, torques = self._signs * (np.array([angles, velocities, torques]) - self._joint_zeros)
        return angles, velocities, torques if self._applied is None else np.array(self._applied)

    def foot_positions(self) -> np.ndarray:
        """(4, 3) foot centres in the world frame, metres."""
        states = self._link_states(self.body, self._toes)
        return np.array([state[0] for state in states])

    def foot_contacts(self) -> FootContacts:
        """Contacts of the last physics step."""
        touching, body_touches = [False] * 4, False
        force = [[0.0, 0.0, 0.0] for _ in range(4)]
        for point in self._contact_points(bodyA=self.body):
            foot = self._foot_of_link.get(point[3])
            if foot is None:
                body_touches = body_touches or (point[2] != self.body and point[9] > TOUCH_N)
                continue
            touching[foot] = True
            normal, friction_1, friction_2 = point[7], point[11], point[13]
            press, slip_1, slip_2, total = point[9], point[10], point[12], force[foot]
            total[0] += press * normal[0] + slip_1 * friction_1[0] + slip_2 * friction_2[0]
            total[1] += press * normal[1] + slip_1 * friction_1[1] + slip_2 * friction_2[1]
            total[2] += press * normal[2] + slip_1 * friction_1[2] + slip_2 * friction_2[2]
        return FootContacts(np.array(touching), np.array(force), body_touches)

    def solids(self) -> MovingSolids:
        """The robot's collision shapes, good until the next world is built."""
        from stair_env.sensors.camera.renderers.bullet_shapes import BodyShapes  # SciPy, which blind workers do without

        return BodyShapes(self.client, self.body)

    def follow_with_camera(self, position: np.ndarray, yaw_deg: float = 50.0) -> None:
        """Keep Bullet's window on the robot (GUI only)."""
        if self._gui:
            self.client.resetDebugVisualizerCamera(1.8, yaw_deg, -20.0, list(position))
