"""What turns joint targets into motion: the engine's position motors, or torques at the physics rate as on a robot."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from stair_env.common.constants import CONTROL_DT
from stair_env.common.field_kinds import naming_fields
from stair_env.common.validation import SpecError, check_choice, check_range, from_mapping, has_parts
from stair_env.physics.body_kernels import pd_torques
from stair_env.physics.body_state import BaseTrack
from stair_env.physics.interface import Physics
from stair_env.robots import NUM_JOINTS, RobotSpec, per_joint

ACTUATORS = ("position", "pd")
ACTUATOR_PARTS = ("rotor_inertia", "reset", "command", "torques")
PerJoint = float | Sequence[float]


class MotorBody(NamedTuple):
    """What is drawn about an episode's motors, as factors.

    Attributes:
        strength: on the largest torques.
        stiffness: on kp.
        damping: on kd.
    """

    strength: float = 1.0
    stiffness: float = 1.0
    damping: float = 1.0


class Actuator(Protocol):
    """Twelve motors, asked for torques 240 times a second; canonical joints, see `stair_env.robots`.

    Attributes:
        rotor_inertia: (12,) of the motors as seen at the joints, kg·m².
    """

    rotor_inertia: np.ndarray

    def reset(self, body: MotorBody, joint_angles: np.ndarray) -> None:
        """Begin an episode.

        Args:
            body: what was drawn about the motors.
            joint_angles: (12,) at which the robot stands, radians.
        """

    def command(self, targets: np.ndarray) -> None:
        """Take (12,) joint targets, radians, that count until the next control step."""

    def torques(self, positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        """(12,) torques for the next physics step, N·m.

        Args:
            positions: (12,) radians.
            velocities: (12,) rad/s.
        """


@dataclass(frozen=True)
class PdActuator:
    """PD control with the limits of a motor: torque = kp (target - q) - kd (dq - feed_forward · rate of the target).

    Each of the first five is a number, three (hip, upper, lower) or twelve; None takes the robot's (`RobotSpec`).

    Attributes:
        kp: N·m/rad.
        kd: N·m·s/rad.
        max_torque: N·m.
        max_speed: rad/s, at which a motor has no torque left in the direction of its motion; against it, it has all.
        rotor_inertia: of the motor as seen at the joint, kg·m²: real ones have it, and without it a light shank would
            chatter at these gains.
        corner: share of max_speed up to which there is the whole torque; from there it falls in a straight line.
        feed_forward: 0 damps all motion, as learned policies are used to; 1 damps only what differs from the target's
            own motion, as a gait that plans smooth targets wants it.

    Raises:
        SpecError: a value is out of range, or not as many as joints.
    """

    kp: PerJoint | None = None
    kd: PerJoint | None = None
    max_torque: PerJoint | None = None
    max_speed: PerJoint | None = None
    rotor_inertia: PerJoint | None = None
    corner: float = 0.5
    feed_forward: float = 0.0

    @naming_fields
    def __post_init__(self) -> None:
        for name, highest in (
            ("kp", 2000.0),
            ("kd", 50.0),
            ("max_torque", 1000.0),
            ("max_speed", 200.0),
            ("rotor_inertia", 1.0),
        ):
            if getattr(self, name) is not None:
                per_joint(f"actuator.{name}", getattr(self, name), 0.0, highest)
        check_range("actuator.corner", self.corner, 0.0, 0.99)
        check_range("actuator.feed_forward", self.feed_forward, 0.0, 1.0)


class PdMotors:
    """An Actuator under PD control.

    Args:
        config: gains and limits.
        robot: whose, where the config leaves them out.
    """

    def __init__(self, config: PdActuator, robot: RobotSpec) -> None:
        self.config = config
        self._nominal = {}
        for name in ("kp", "kd", "max_torque", "max_speed", "rotor_inertia"):
            own = getattr(config, name)
            value = getattr(robot, name) if own is None else own
            self._nominal[name] = per_joint(f"actuator.{name}", value, 0.0, np.inf)
        self.rotor_inertia = self._nominal["rotor_inertia"]
        self.reset(MotorBody(), np.zeros(NUM_JOINTS))

    def reset(self, body: MotorBody, joint_angles: np.ndarray) -> None:
        """Begin an episode, see `Actuator`."""
        nominal = self._nominal
        self._kp, self._kd = body.stiffness * nominal["kp"], body.damping * nominal["kd"]
        self._max_torque, self._max_speed = body.strength * nominal["max_torque"], nominal["max_speed"]
        self._targets, self._rates = np.array(joint_angles, np.float64), np.zeros(NUM_JOINTS)

    def command(self, targets: np.ndarray) -> None:
        """Take new targets, see `Actuator`."""
        self._rates = (targets - self._targets) * (self.config.feed_forward / CONTROL_DT)
        self._targets = np.array(targets, np.float64)

    def torques(self, positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        """(12,) torques now, see `Actuator`."""
        limits = self._max_torque, self._max_speed, self.config.corner
        found: np.ndarray = pd_torques(self._targets, self._rates, positions, velocities, self._kp, self._kd, *limits)
        return found


class Motors(Protocol):
    """The robot's motors as the environment uses them."""

    def reset(self, sim: Physics, body: MotorBody, joint_angles: np.ndarray) -> None:
        """Begin an episode; the robot has just been put at (12,) joint angles, radians."""

    def hold(self, joint_angles: np.ndarray, steps: int) -> None:
        """Hold (12,) joint angles for some physics steps."""

    def command(self, targets: np.ndarray) -> None:
        """Take the (12,) targets of a control step, radians."""

    def advance(self, steps: int) -> BaseTrack:
        """Let physics steps pass."""


class PositionMotors:
    """The engine's position motors, a constraint of its solver: stiff, and stable whatever the time step."""

    def reset(self, sim: Physics, body: MotorBody, joint_angles: np.ndarray) -> None:
        """Begin an episode, see `Motors`."""
        self._sim, self._strength = sim, body.strength

    def hold(self, joint_angles: np.ndarray, steps: int) -> None:
        """Hold joint angles, see `Motors`."""
        for _ in range(steps):
            self._sim.command_joints(joint_angles)
            self._sim.step_physics()

    def command(self, targets: np.ndarray) -> None:
        """Take targets, see `Motors`."""
        self._sim.command_joints(targets, self._strength)

    def advance(self, steps: int) -> BaseTrack:
        """Let time pass, see `Motors`."""
        return self._sim.step_and_track(steps)


class TorqueMotors:
    """Motors whose torques an Actuator computes before each physics step.

    Args:
        actuator: what does.
    """

    def __init__(self, actuator: Actuator) -> None:
        self.actuator = actuator

    def reset(self, sim: Physics, body: MotorBody, joint_angles: np.ndarray) -> None:
        """Begin an episode, see `Motors`."""
        self._sim = sim
        sim.release_joints()
        sim.add_rotor_inertia(self.actuator.rotor_inertia)
        self.actuator.reset(body, joint_angles)

    def hold(self, joint_angles: np.ndarray, steps: int) -> None:
        """Hold joint angles, see `Motors`."""
        self.command(joint_angles)
        self.advance(steps)

    def command(self, targets: np.ndarray) -> None:
        """Take targets, see `Motors`."""
        self.actuator.command(targets)

    def advance(self, steps: int) -> BaseTrack:
        """Let time pass, see `Motors`."""
        return self._sim.step_under_torques(self.actuator.torques, steps)


def make_motors(actuator: Any, robot: RobotSpec, default: str) -> Motors:
    """Build a robot's motors.

    Args:
        actuator: name in ACTUATORS, fields of a PdActuator, one, an Actuator (of which each environment takes a copy),
            or what makes one for a robot, for example its class; None takes the default.
        robot: which robot.
        default: name in ACTUATORS.

    Raises:
        SpecError: the argument is wrong; the message names it, its value and the choices.
    """
    actuator = default if actuator is None else actuator
    if isinstance(actuator, str):
        check_choice("actuator", actuator, ACTUATORS)
        return PositionMotors() if actuator == "position" else TorqueMotors(PdMotors(PdActuator(), robot))
    if isinstance(actuator, Mapping):
        return TorqueMotors(PdMotors(from_mapping("actuator", PdActuator, actuator), robot))
    if isinstance(actuator, PdActuator):
        return TorqueMotors(PdMotors(actuator, robot))
    factory = callable(actuator) and not has_parts(actuator, ACTUATOR_PARTS)
    made = actuator(robot) if factory else copy.deepcopy(actuator)
    if not has_parts(made, ACTUATOR_PARTS):
        raise SpecError(
            f"actuator={actuator!r} must be one of {', '.join(map(repr, ACTUATORS))}, a PdActuator or its fields, an "
            f"object with {', '.join(ACTUATOR_PARTS)}, or a function that makes one from a RobotSpec"
        )
    return TorqueMotors(made)
