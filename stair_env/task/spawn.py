"""Where the robot starts, standing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stair_env.common.validation import check_choice, check_range
from stair_env.robots import RobotSpec
from stair_env.stairs import StairSpec

SPAWNS = ("floor", "anywhere")
APPROACH_M = (0.35, 0.9)  # from the front hips to the first edge
SPAWN_YAW_RAD = 0.12
SPAWN_LATERAL_M = 0.12
FOOT_CLEAR_M = 0.06
ON_FLIGHT_SHARE = 0.3
RESET_OPTIONS = ("stairs", "x", "y", "yaw")
START_LIMIT = 100.0  # metres, or radians: beyond any staircase


@dataclass(frozen=True)
class Spawn:
    """Where the robot starts, standing.

    Attributes:
        position: (3,) base, world, metres.
        yaw, pitch: radians, pitch nose down.
        feet_in_base: (4, 3) foot centres, metres.
    """

    position: np.ndarray
    yaw: float
    pitch: float
    feet_in_base: np.ndarray


def draw_spawn(spec: StairSpec, robot: RobotSpec, spawn: str, rng: np.random.Generator) -> Spawn:
    """Put the robot before the first edge, or (spawn="anywhere") now and then on the flight."""
    approach, lateral, yaw, coin, where = rng.uniform(size=5)
    x = -robot.hip_x[0] - (APPROACH_M[0] + approach * (APPROACH_M[1] - APPROACH_M[0]))
    edge_x = spec.profile().edge_x
    on_flight = spawn == "anywhere" and coin < ON_FLIGHT_SHARE and len(edge_x) > 2
    if on_flight:
        x = float(edge_x[0] + where * (edge_x[-1] - edge_x[0]) - robot.hip_x[0])
    lateral, yaw = SPAWN_LATERAL_M * (2 * lateral - 1), SPAWN_YAW_RAD * (2 * yaw - 1) * (0.3 if on_flight else 1.0)
    return standing_at(spec, robot, x, float(lateral), float(yaw))


def standing_at(spec: StairSpec, robot: RobotSpec, x: float, y: float, yaw: float) -> Spawn:
    """Stand on whatever is under the feet, each foot clear of the edges.

    Args:
        spec: the staircase.
        robot: which robot.
        x, y: of the base, world, metres.
        yaw: heading, radians.
    """
    profile = spec.profile()
    cos, sin = np.cos(yaw), np.sin(yaw)
    feet = robot.nominal_feet
    world = np.stack([x + cos * feet[:, 0] - sin * feet[:, 1], y + sin * feet[:, 0] + cos * feet[:, 1]], axis=1)
    for foot in range(4):
        nearest = profile.edge_x[np.argmin(np.abs(profile.edge_x - world[foot, 0]))]
        gap = world[foot, 0] - nearest
        if abs(gap) < FOOT_CLEAR_M:
            world[foot, 0] = nearest + np.copysign(FOOT_CLEAR_M, gap)
    ground = profile.height_at(world[:, 0])
    pitch = -0.8 * float(np.arctan2(ground[:2].mean() - ground[2:].mean(), feet[0, 0] - feet[2, 0]))
    position = np.array([x, y, ground.mean() + robot.foot_radius + robot.stand_height])
    relative = np.column_stack([world, ground + robot.foot_radius]) - position
    turn_back = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    tip_back = np.array([[np.cos(pitch), 0.0, -np.sin(pitch)], [0.0, 1.0, 0.0], [np.sin(pitch), 0.0, np.cos(pitch)]])
    return Spawn(position, yaw, pitch, relative @ turn_back.T @ tip_back.T)


def read_reset_options(options: Mapping[str, Any] | None) -> tuple[StairSpec | None, dict[str, float]]:
    """The staircase that the options of a reset ask for, if they do, and where on it to start.

    Raises:
        SpecError: an unknown option, or a wrong value.
    """
    for name in options or {}:
        check_choice("option", name, RESET_OPTIONS)
    given = dict(options or {})
    stairs = given.pop("stairs", None)
    for name, value in given.items():
        check_range(f"option {name}", value, -START_LIMIT, START_LIMIT)
    start = {name: float(value) for name, value in given.items()}
    return (stairs if stairs is None or isinstance(stairs, StairSpec) else StairSpec.from_dict(stairs)), start
