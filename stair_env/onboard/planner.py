"""What turns actions and the stair block into joint targets: the trot, joint offsets, or a planner of one's own."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from stair_env.common.validation import SpecError, check_choice, has_parts
from stair_env.observation import StairBlock
from stair_env.onboard.gait import Gait, GaitConfig
from stair_env.onboard.kinematics import LegKinematics
from stair_env.robots import NUM_JOINTS, RobotSpec

ACTUATIONS = ("gait", "joint")
GAITS: dict[str, GaitConfig] = {"trot": GaitConfig()}
JOINT_ACTION_RAD = 0.5  # actuation="joint": an action of ±1 moves a joint this far from standing
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


class JointOffsets:
    """No gait: an action moves each joint away from standing.

    Args:
        robot: which robot.
    """

    action_size = NUM_JOINTS

    def __init__(self, robot: RobotSpec) -> None:
        self._idle = Gait(robot)  # stands for the cycle and the footholds in the observation
        self._standing = LegKinematics(robot).joint_angles(robot.nominal_feet)

    @property
    def phase(self) -> float:
        """Phase drawn at the start; it stays."""
        return self._idle.phase

    @property
    def foothold_heights(self) -> np.ndarray:
        """(4,) heights of the feet at the start relative to their mean, metres."""
        return self._idle.foothold_heights

    def reset(self, foot_heights: np.ndarray, phase: float = 0.0, pitch: float = 0.0) -> None:
        """Start from standing, see `GaitPlanner`."""
        self._idle.reset(foot_heights, phase, pitch)

    def joint_targets(
        self, action: np.ndarray, block: StairBlock, odometry_velocity: np.ndarray, dt: float
    ) -> np.ndarray:
        """Return (12,) joint angles, radians: standing plus JOINT_ACTION_RAD times the action."""
        targets: np.ndarray = self._standing + JOINT_ACTION_RAD * action
        return targets


def make_planner(
    gait: str | GaitConfig | GaitPlanner | Callable[[RobotSpec], GaitPlanner], actuation: str, robot: RobotSpec
) -> GaitPlanner:
    """Build a planner.

    Args:
        gait: name in GAITS, numbers of the trot, a planner (of which each environment takes a copy), or what makes one
            for a robot, for example its class.
        actuation: "gait", or "joint" for none.
        robot: which robot.

    Raises:
        SpecError: an argument is wrong; the message names it, its value and the choices.
    """
    check_choice("actuation", actuation, ACTUATIONS)
    if actuation == "joint":
        if not (isinstance(gait, str) and gait == "trot"):
            raise SpecError(f'gait={gait!r} needs actuation="gait", not "joint"')
        return JointOffsets(robot)
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
