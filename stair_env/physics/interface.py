"""What the environment, its motors and its camera ask of a physics engine, and numbers that all engines share.

Engines are chosen by name in `stair_env.physics.engines`. Each answers in canonical terms (see `stair_env.robots`) and
keeps its link indices, inertial frames and joint conventions to itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from stair_env.physics.body_state import BaseState, BaseTrack, RobotReading
from stair_env.robots import RobotSpec
from stair_env.scene.shapes import Shape

# Of Bullet's position motor, with velocities fed forward (docs/climbing.md): in a physics step a joint makes up for
# this share of its angle's error, and for that share of what its velocity differs from the target's.
POSITION_GAIN, VELOCITY_GAIN = 0.03, 0.8
FOOT_FRICTION, LINK_FRICTION = 1.0, 0.5  # multiplied with the ground's
LEAST_TRUNK_MASS_KG = 0.2  # whatever a payload takes away
TOUCH_N = 1.0  # from which a part of the robot other than a foot counts as touching something
SHAPE_COLOURS = {
    "floor": (0.62, 0.61, 0.58, 1.0),
    "step": (0.72, 0.69, 0.64, 1.0),
    "wall": (0.86, 0.85, 0.82, 1.0),
    "rail": (0.35, 0.36, 0.38, 1.0),
    "stringer": (0.45, 0.36, 0.28, 1.0),
}
DEFAULT_COLOUR = (0.6, 0.55, 0.5, 1.0)


class MovingSolids(Protocol):
    """The robot's solids, for the ray-caster."""

    def shapes(self) -> list[Shape]:
        """Where they are now, world frame."""


class Physics(Protocol):
    """A robot among solids, in steps of 1/240 s.

    Attributes:
        robot: which robot.
    """

    robot: RobotSpec

    @property
    def client(self) -> Any:
        """The Bullet client that Bullet's own renderers draw; None where another engine works."""

    def close(self) -> None:
        """Release what the engine holds; safe to call twice."""

    def build(self, shapes: Sequence[Shape], friction: float) -> None:
        """Start an empty world, put the solids in and load the robot far above them.

        Args:
            shapes: solids of the scene.
            friction: lateral friction coefficient of the ground against the feet.
        """

    def set_payload(self, kilograms: float) -> None:
        """Add mass to the trunk (negative takes some away)."""

    def place_robot(self, position: np.ndarray, yaw: float, joint_angles: np.ndarray, pitch: float = 0.0) -> None:
        """Teleport the robot, at rest.

        Args:
            position: (3,) base origin, world frame, metres.
            yaw: heading, radians.
            joint_angles: (12,) canonical, radians.
            pitch: nose-down angle about the base's y axis, radians.
        """

    def command_joints(self, joint_angles: np.ndarray, strength: float = 1.0) -> None:
        """Set the position motors' targets for a control step; the velocity towards them is fed forward.

        Args:
            joint_angles: (12,) canonical, radians.
            strength: factor on the largest torque.
        """

    def release_joints(self) -> None:
        """Switch the position motors off; from here on torques move the joints."""

    def add_rotor_inertia(self, rotor_inertia: np.ndarray) -> None:
        """Make joints as heavy to speed up as motors behind their gears are; a fresh world has forgotten it.

        Args:
            rotor_inertia: (12,) as seen at the joints, kg·m².
        """

    def step_physics(self) -> None:
        """Advance one physics step."""

    def step_and_track(self, steps: int) -> BaseTrack:
        """Advance some physics steps and tell how the trunk moved since the last track."""

    def step_under_torques(self, torques: Callable[[np.ndarray, np.ndarray], np.ndarray], steps: int) -> BaseTrack:
        """Advance some physics steps under torques that are computed anew before each.

        Args:
            torques: of canonical angles (12,) rad and velocities (12,) rad/s: canonical torques (12,) N·m.
            steps: of 1/240 s.
        """

    def begin_track(self) -> BaseTrack:
        """Where the trunk is now, without motion; the next track continues from here."""

    def push(self, velocity: np.ndarray) -> None:
        """Add a velocity (3,) m/s to the trunk at once, as a shove does."""

    def base_state(self) -> BaseState:
        """Pose and velocity of the canonical base frame."""

    def read_robot(self) -> RobotReading:
        """Joints, contacts and feet now."""

    def solids(self) -> MovingSolids:
        """The robot's solids, good until the next world is built."""

    def follow_with_camera(self, position: np.ndarray, yaw_deg: float = 50.0) -> None:
        """Keep the engine's window on (3,) a position, metres, where there is one."""
