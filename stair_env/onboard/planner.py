"""What turns actions and the stair block into joint targets: the trot, joint offsets, or a planner of one's own."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from stair_env.common.field_kinds import naming_fields
from stair_env.common.validation import SpecError, check_choice, check_range, from_mapping, has_parts
from stair_env.observation import StairBlock
from stair_env.onboard.gait import Gait, GaitConfig
from stair_env.onboard.kinematics import LegKinematics
from stair_env.robots import NUM_JOINTS, RobotSpec, per_joint

ACTUATIONS = ("gait", "joint")
GAITS: dict[str, GaitConfig] = {"trot": GaitConfig()}
# How far an action of ±1 moves each joint of a leg (hip, upper, lower), radians: what the gait asks of them on the
# ladder, both ways, with some to spare (docs/parts.md has the figures).
JOINT_ACTION_RAD = (0.6, 1.6, 1.6)
PLANNER_PARTS = ("action_size", "phase", "foothold_heights", "reset", "joint_targets")


class GaitPlanner(Protocol):
    """What the environment needs of a gait; it reads nothing but what it is handed.

    Attributes:
        action_size: length of the action.
        phase: where in its cycle the gait is, 0..1; the observation holds its sine and cosine.
        foothold_heights: (4,) planned foothold of each foot relative to their mean, metres, canonical leg order.
    """

    @property
    def action_size(self) -> int:
        """Length of the action."""

    @property
    def phase(self) -> float:
        """Where in its cycle the gait is, 0..1."""

    @property
    def foothold_heights(self) -> np.ndarray:
        """(4,) planned foothold of each foot relative to their mean, metres."""

    def reset(self, foot_heights: np.ndarray, phase: float = 0.0, pitch: float = 0.0) -> None:
        """Start from standing.

        Args:
            foot_heights: (4,) measured heights of the feet relative to the right front foot, metres.
            phase: where in the cycle to begin, 0..1.
            pitch: of the trunk, nose down, radians.
        """

    def joint_targets(
        self, action: np.ndarray, block: StairBlock, odometry_velocity: np.ndarray, dt: float
    ) -> np.ndarray:
        """Plan one control step.

        Args:
            action: (action_size,) float64 in [-1, 1].
            block: stair block of the last observation.
            odometry_velocity: (3,) measured velocity of the base over the last step, level frame, m/s.
            dt: control step, seconds.

        Returns:
            (12,) canonical joint angles, radians.
        """


@dataclass(frozen=True)
class JointActuation:
    """What actions mean without a gait: joint target = pose + scale · action.

    Attributes:
        scale: of each joint, or of the three of a leg (hip, upper, lower), or of all, radians.
        pose: where actions of zero put the joints, canonical angles, three or twelve, radians; None stands.
        clock_hz: of the cycle whose sine and cosine are in the observation, for policies that want to keep time; with 0
            there is no clock, and the phase stays 0.

    Raises:
        SpecError: a value is out of range, or not as many as joints.
    """

    scale: float | Sequence[float] = JOINT_ACTION_RAD
    pose: Sequence[float] | None = None
    clock_hz: float = 0.0

    @naming_fields
    def __post_init__(self) -> None:
        per_joint("actuation.scale", self.scale, 0.0, math.pi)
        if self.pose is not None:
            per_joint("actuation.pose", self.pose, -math.pi, math.pi)
        check_range("actuation.clock_hz", self.clock_hz, 0.0, 10.0)


class JointOffsets:
    """No gait: an action moves each joint away from a pose.

    Args:
        robot: which robot.
        config: what actions mean.

    Attributes:
        pose: (12,) where actions of zero put the joints, radians.
        scale: (12,) how far an action of 1 moves them, radians.
        phase: of the clock, 0..1.
        foothold_heights: (4,) zeros.
    """

    action_size = NUM_JOINTS

    def __init__(self, robot: RobotSpec, config: JointActuation | None = None) -> None:
        self.config = config or JointActuation()
        standing = LegKinematics(robot).joint_angles(robot.nominal_feet)
        pose = self.config.pose
        self.pose = standing if pose is None else per_joint("actuation.pose", pose, -math.pi, math.pi)
        self.scale = per_joint("actuation.scale", self.config.scale, 0.0, math.pi)
        self.foothold_heights = np.zeros(4)  # nothing is planned
        self.phase = 0.0

    def reset(self, foot_heights: np.ndarray, phase: float = 0.0, pitch: float = 0.0) -> None:
        """Start from standing, see `GaitPlanner`."""
        self.phase = phase if self.config.clock_hz else 0.0

    def joint_targets(
        self, action: np.ndarray, block: StairBlock, odometry_velocity: np.ndarray, dt: float
    ) -> np.ndarray:
        """Return (12,) joint angles, radians: the pose plus scale times the action."""
        self.phase = (self.phase + self.config.clock_hz * dt) % 1.0
        targets: np.ndarray = self.pose + self.scale * action
        return targets

    def action_for(self, targets: np.ndarray) -> np.ndarray:
        """The (12,) action that asks for joint targets, clipped to [-1, 1]: how a teacher's targets become actions."""
        action: np.ndarray = np.clip((targets - self.pose) / np.maximum(self.scale, 1e-9), -1.0, 1.0)
        return action


def make_planner(
    gait: str | GaitConfig | GaitPlanner | Callable[[RobotSpec], GaitPlanner],
    actuation: str | Mapping[str, Any] | JointActuation,
    robot: RobotSpec,
) -> GaitPlanner:
    """Build a planner.

    Args:
        gait: name in GAITS, numbers of the trot, a planner (of which each environment takes a copy), or what makes one
            for a robot, for example its class.
        actuation: "gait", or "joint", a JointActuation or its fields for none.
        robot: which robot.

    Raises:
        SpecError: an argument is wrong; the message names it, its value and the choices.
    """
    if isinstance(actuation, Mapping):
        actuation = from_mapping("actuation", JointActuation, actuation)
    if not isinstance(actuation, JointActuation):
        check_choice("actuation", actuation, ACTUATIONS)
    if actuation != "gait":
        if not (isinstance(gait, str) and gait == "trot"):
            raise SpecError(f'gait={gait!r} needs actuation="gait", not {actuation!r}')
        return JointOffsets(robot, actuation if isinstance(actuation, JointActuation) else None)
    if isinstance(gait, str):
        check_choice("gait", gait, tuple(GAITS))
        return Gait(robot, GAITS[gait])
    if isinstance(gait, GaitConfig):
        return Gait(robot, gait)
    made: Any = gait
    if callable(gait) and (isinstance(gait, type) or not hasattr(gait, "joint_targets")):
        made = gait(robot)
    else:
        made = copy.deepcopy(gait)
    if not has_parts(made, PLANNER_PARTS):
        raise SpecError(
            f"gait={gait!r} must be one of {', '.join(map(repr, GAITS))}, a GaitConfig, an object with "
            f"{', '.join(PLANNER_PARTS)}, or a function that makes one from a RobotSpec"
        )
    planner: GaitPlanner = made
    return planner
