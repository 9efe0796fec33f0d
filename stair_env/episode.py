"""What varies from episode to episode: the staircase, where the robot starts, and the body it has."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from stair_env.robots import RobotSpec
from stair_env.stairs import (
    RISER_RANGE_M,
    STEP_COUNT_RANGE,
    TREAD_RANGE_M,
    SpecError,
    StairSpec,
    as_range,
    check_choice,
    check_range,
)

ENV_DIRECTIONS = ("up", "down", "both")
LIGHTINGS = ("day", "night", "random")
SPAWNS = ("floor", "anywhere")
Range = tuple[float, float]


class Body(NamedTuple):
    """What is drawn about the robot's body and the ground for one episode.

    Attributes:
        friction: of the ground against rubber feet.
        payload_kg: added to the trunk.
        motor_strength: factor on the largest torques.
    """

    friction: float
    payload_kg: float
    motor_strength: float


@dataclass(frozen=True)
class Randomization:
    """Domain randomisation of the body and the ground; each pair is drawn from uniformly, once per episode.

    Attributes:
        friction: of the ground against rubber feet.
        payload_kg: added to the trunk.
        motor_strength: factor on the largest torques.
        push_speed: largest sudden change of the trunk's velocity, m/s.
        push_interval_s: mean time between pushes; 0 means none.
        command_latency: chance that a control step's command arrives one step late.
        camera_tilt_rad: largest error of the camera's mounting pitch and roll.
    """

    friction: Range = (0.7, 1.1)
    payload_kg: Range = (-0.5, 1.5)
    motor_strength: Range = (0.9, 1.1)
    push_speed: float = 0.2
    push_interval_s: float = 4.0
    command_latency: float = 0.1
    camera_tilt_rad: float = 0.01

    def __post_init__(self) -> None:
        object.__setattr__(self, "friction", as_range("randomization.friction", self.friction, 0.1, 5.0))
        object.__setattr__(self, "payload_kg", as_range("randomization.payload_kg", self.payload_kg, -10.0, 30.0))
        strength = as_range("randomization.motor_strength", self.motor_strength, 0.1, 3.0)
        object.__setattr__(self, "motor_strength", strength)
        check_range("randomization.push_speed", self.push_speed, 0.0, 5.0)
        check_range("randomization.push_interval_s", self.push_interval_s, 0.0, 1e4)
        check_range("randomization.command_latency", self.command_latency, 0.0, 1.0)
        check_range("randomization.camera_tilt_rad", self.camera_tilt_rad, 0.0, 0.2)

    def draw(self, rng: np.random.Generator) -> Body:
        """One episode's body."""
        return Body(*(float(rng.uniform(*span)) for span in (self.friction, self.payload_kg, self.motor_strength)))


NOMINAL = Randomization((0.9, 0.9), (0.0, 0.0), (1.0, 1.0), 0.0, 0.0, 0.0, 0.0)


def read_randomization(value: Any) -> Randomization:
    """None or False: nominal body. True: the defaults. A mapping: the defaults with changes.

    Raises:
        SpecError: anything else, or a wrong field.
    """
    if value is None or value is False:
        return NOMINAL
    if value is True:
        return Randomization()
    return _from_mapping("randomization", Randomization, value)


@dataclass(frozen=True)
class CurriculumConfig:
    """Raises the riser height as the policy succeeds.

    Attributes:
        start: riser of level 0, metres.
        levels: steps between `start` and the upper end of the environment's riser range.
        promote: success rate over the window that raises the level.
        demote: success rate that lowers it.
        window: episodes looked at.
        review: share of episodes drawn from any riser up to the level's, the rest are at the level.
    """

    start: float = 0.03
    levels: int = 14
    promote: float = 0.7
    demote: float = 0.2
    window: int = 10
    review: float = 0.3

    def __post_init__(self) -> None:
        check_range("curriculum.start", self.start, *RISER_RANGE_M)
        check_range("curriculum.levels", self.levels, 1, 1000)
        check_range("curriculum.promote", self.promote, 0.0, 1.0)
        check_range("curriculum.demote", self.demote, 0.0, self.promote)
        check_range("curriculum.window", self.window, 1, 1000)
        check_range("curriculum.review", self.review, 0.0, 1.0)


class Curriculum:
    """Level of one environment; `state` and `restore` make it checkpointable.

    Args:
        config: when to go up and down.
        highest: riser at the last level, metres.
    """

    def __init__(self, config: CurriculumConfig, highest: float) -> None:
        self.config = config
        self.highest = highest
        self.level = 0
        self._results: deque[bool] = deque(maxlen=config.window)

    @property
    def riser_height(self) -> float:
        """Riser of the current level, metres."""
        return self.config.start + (self.highest - self.config.start) * self.level / self.config.levels

    def report(self, success: bool) -> None:
        """Tell how an episode ended."""
        self._results.append(success)
        if len(self._results) < self.config.window:
            return
        rate = sum(self._results) / len(self._results)
        step = int(rate >= self.config.promote) - int(rate <= self.config.demote)
        level = min(max(self.level + step, 0), self.config.levels)
        if level != self.level:
            self.level = level
            self._results.clear()

    def draw_riser(self, lowest: float, rng: np.random.Generator) -> float:
        """Riser for the next episode, metres."""
        top = self.riser_height
        bottom = min(lowest, top, self.config.start)
        return float(rng.uniform(bottom, top)) if rng.random() < self.config.review else top

    def state(self) -> dict[str, Any]:
        """JSON-able state."""
        return {"level": self.level, "results": list(self._results)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from `state()`."""
        self.level = int(state["level"])
        self._results = deque((bool(result) for result in state["results"]), maxlen=self.config.window)


def read_curriculum(value: Any, highest: float) -> Curriculum | None:
    """None or False: none. True: the defaults. A mapping: the defaults with changes.

    Raises:
        SpecError: anything else, or a wrong field.
    """
    if value is None or value is False:
        return None
    config = CurriculumConfig() if value is True else _from_mapping("curriculum", CurriculumConfig, value)
    return Curriculum(config, highest)


def _from_mapping(name: str, cls: type, value: Any) -> Any:
    fields = tuple(field.name for field in dataclasses.fields(cls))
    if not isinstance(value, Mapping):
        raise SpecError(f"{name}={value!r} must be None, True or a mapping with any of {', '.join(fields)}")
    for key in value:
        check_choice(f"{name} field", key, fields)
    return cls(**value)


@dataclass(frozen=True)
class StairRanges:
    """From what staircases are drawn.

    Attributes:
        direction: "up", "down" or "both" (a coin decides).
        riser_height, tread_depth: metres, low and high.
        num_steps: low and high, inclusive.
        flight_width: metres.
        uneven: largest deviation of single risers and treads, metres.
    """

    direction: str = "up"
    riser_height: Range = (0.10, 0.17)
    tread_depth: Range = (0.26, 0.34)
    num_steps: Range = (4, 7)
    flight_width: float = 1.2
    uneven: float = 0.0

    def __post_init__(self) -> None:
        check_choice("direction", self.direction, ENV_DIRECTIONS)
        object.__setattr__(self, "riser_height", as_range("riser_height", self.riser_height, *RISER_RANGE_M))
        object.__setattr__(self, "tread_depth", as_range("tread_depth", self.tread_depth, *TREAD_RANGE_M))
        steps = as_range("num_steps", self.num_steps, *STEP_COUNT_RANGE)
        if any(count != int(count) for count in steps):
            raise SpecError(f"num_steps={self.num_steps!r} must be whole numbers")
        object.__setattr__(self, "num_steps", steps)
        check_range("flight_width", self.flight_width, 0.6, 6.0)
        check_range("uneven", self.uneven, 0.0, 0.03)

    def draw(self, rng: np.random.Generator, curriculum: Curriculum | None) -> StairSpec:
        """One staircase."""
        coin = rng.random() < 0.5
        direction = self.direction if self.direction != "both" else ("up" if coin else "down")
        riser = float(rng.uniform(*self.riser_height))
        if curriculum is not None:
            riser = curriculum.draw_riser(self.riser_height[0], rng)
        steps = int(rng.integers(int(self.num_steps[0]), int(self.num_steps[1]) + 1))
        tread = float(rng.uniform(*self.tread_depth))
        offsets = np.round(rng.uniform(-self.uneven, self.uneven, (2, steps)), 4)
        return StairSpec(
            direction=direction,  # type: ignore[arg-type]
            riser_height=riser,
            tread_depth=tread,
            num_steps=steps,
            flight_width=self.flight_width,
            riser_offsets=tuple(offsets[0]) if self.uneven else (),
            tread_offsets=tuple(offsets[1]) if self.uneven else (),
        )


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


APPROACH_M = (0.35, 0.9)  # from the front hips to the first edge
SPAWN_YAW_RAD = 0.12
SPAWN_LATERAL_M = 0.12
FOOT_CLEAR_M = 0.06
ON_FLIGHT_SHARE = 0.3


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
