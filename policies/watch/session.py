"""A robot that climbs flight after flight, and what a spectator may do to it; knows nothing of any page."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from perception.geometry.results import StairEstimate
from perception.looking.rerun_log import treads
from policies import pretrained
from policies.make_env import PERCEPTION_ID, make_env
from policies.report.flight_log import next_edge, nosings
from policies.rollout import Predictor, ZeroAction
from stair_env.common.constants import (
    CONTROL_DT,
    CONTROL_RATE_HZ,
    SCENE_LIGHTINGS,
    WALKING_DIRECTIONS,
    WATCHED_AGENTS,
)
from stair_env.common.validation import check_choice
from stair_env.observation import STAIR_FIELDS
from stair_env.physics.simulation import Simulation, base_to_world
from stair_env.robots import get_robot, mount_to_base
from stair_env.stairs import StairSpec

MAX_STEPS = round(30 * CONTROL_RATE_HZ)  # of a flight, which takes about seven seconds
END_STEPS = round(1.5 * CONTROL_RATE_HZ)  # control steps for which the end of a flight stays in view
PUSH_M_S = 0.4  # the trunk's change of velocity
PUSHES = {"forward": (1.0, 0.0), "back": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}  # in the robot's axes


@dataclass(frozen=True)
class WatchConfig:
    """What there is to see at first.

    Args:
        robot: which robot.
        agent: who walks, one of `WATCHED_AGENTS`.
        policy: shipped name, folder or file; None takes the robot's name.
        direction: "up" or "down".
        riser_height, tread_depth: metres.
        num_steps: of the flight.
        lighting: "day" or "night".
        seed: of everything that is drawn by chance.

    Raises:
        ValueError: a wrong value; the message names argument, value and choices.
    """

    robot: str = "aliengo"
    agent: str = "policy"
    policy: str | None = None
    direction: str = "up"
    riser_height: float = 0.13
    tread_depth: float = 0.30
    num_steps: int = 5
    lighting: str = "day"
    seed: int = 0

    def __post_init__(self) -> None:
        get_robot(self.robot)
        check_choice("agent", self.agent, WATCHED_AGENTS)
        check_choice("direction", self.direction, WALKING_DIRECTIONS)
        check_choice("lighting", self.lighting, SCENE_LIGHTINGS)
        self.stairs()

    def stairs(self) -> StairSpec:
        """The staircase."""
        size = {"riser_height": self.riser_height, "tread_depth": self.tread_depth, "num_steps": self.num_steps}
        return StairSpec(direction=self.direction, **size)  # type: ignore[arg-type]


class RandomAction:
    """Chance walks.

    Args:
        action_space: of the environment.
        seed: of its draws.
    """

    def __init__(self, action_space: gym.Space, seed: int) -> None:
        self._space = action_space
        self._space.seed(seed)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Uniform draws, whatever is seen."""
        return self._space.sample(), state


class WatchSession:
    """An environment with perception in the loop, one flight after the other.

    Args:
        config: what there is to see at first.

    Attributes:
        stairs: that are climbed.
        agent: who walks.
        agents: who could; without a policy for the robot, "policy" is not among them.
        paused: whether time stands still (`advance` then does nothing).
        observation, info: of the last control step.
        outcome: how the flight ended, while its end is in view; else empty.
        flights: what came of those that are over, JSON-able.

    Raises:
        ValueError: no such policy, or it does not fit.
    """

    def __init__(self, config: WatchConfig = WatchConfig()) -> None:
        self.config, self.stairs, self.agent, self.paused = config, config.stairs(), config.agent, False
        name = config.policy or config.robot
        wants_policy = config.policy is not None or config.agent == "policy" or name in pretrained.names()
        if wants_policy:
            pretrained.locate(name)  # a wrong name is told before a simulation is opened
        self.env = make_env(
            PERCEPTION_ID,
            {
                "robot": config.robot,
                "lighting": config.lighting,
                "render_mode": "rgb_array",  # so that the robot's drawn parts are loaded
                "max_episode_steps": MAX_STEPS,
            },
            monitor=False,
        )
        self._predictors: dict[str, Predictor] = {
            "zero": ZeroAction(self.env.action_space),
            "random": RandomAction(self.env.action_space, config.seed),
        }
        try:
            if wants_policy:
                self._predictors = {"policy": pretrained.load(name, self.env), **self._predictors}
            self.agents = tuple(self._predictors)
            self._seeds = np.random.default_rng(config.seed)
            self._camera_to_base = mount_to_base(get_robot(config.robot).camera)
            self.flights: list[dict[str, Any]] = []
            self.restart()
        except BaseException:
            self.env.close()
            raise

    # ------------------------------------------------------------------ what a spectator may do

    def restart(self, **changes: Any) -> None:
        """Begin a flight.

        Args:
            changes: fields of the staircase (`stair_env.stairs.StairSpec`) that are to be different from now on.

        Raises:
            ValueError: a size is out of range.
        """
        self.stairs = dataclasses.replace(self.stairs, **changes)
        options = {"stairs": self.stairs}
        self.observation, self.info = self.env.reset(seed=int(self._seeds.integers(2**31)), options=options)
        self.outcome, self._end_steps, self.steps = "", 0, 0
        self._memory: Any = None
        self._track: deque[tuple[float, np.ndarray]] = deque(maxlen=round(CONTROL_RATE_HZ))
        self._looked: tuple[int, StairEstimate, np.ndarray] | None = None
        self._notice()

    def choose(self, agent: str) -> None:
        """Let another agent walk, from the next control step on.

        Raises:
            ValueError: there is none of this name.
        """
        check_choice("agent", agent, self.agents)
        self.agent, self._memory = agent, None

    def push(self, direction: str) -> None:
        """Shove the trunk.

        Args:
            direction: of PUSHES, in the robot's axes.

        Raises:
            ValueError: there is none of this name.
        """
        check_choice("direction", direction, tuple(PUSHES))
        along, left = PUSHES[direction]
        yaw = float(self.info["truth"]["yaw"])
        velocity = [along * np.cos(yaw) - left * np.sin(yaw), along * np.sin(yaw) + left * np.cos(yaw), 0.0]
        self.simulation.push(PUSH_M_S * np.array(velocity))

    # ------------------------------------------------------------------ time

    def advance(self) -> None:
        """One control step; after a flight's end, its last picture for a while and then the next flight."""
        if self.paused:
            return
        if self.outcome:
            self._end_steps += 1
            if self._end_steps >= END_STEPS:
                self.restart()
            return
        action, self._memory = self._predictors[self.agent].predict(
            self.observation, self._memory, np.array([self.steps == 0]), deterministic=True
        )
        self.observation, _, terminated, truncated, self.info = self.env.step(action)
        self.steps += 1
        self._notice()
        if terminated or truncated:
            self.outcome = str(self.info["termination"] or "time_limit")
            self.flights.append(self._describe())

    def _describe(self) -> dict[str, Any]:
        return {
            "agent": self.agent,
            "direction": self.stairs.direction,
            "riser_height": self.stairs.riser_height,
            "tread_depth": self.stairs.tread_depth,
            "num_steps": self.stairs.num_steps,
            "steps_climbed": int(self.info["steps_climbed"]),
            "success": bool(self.info["is_success"]),
            "termination": self.outcome,
            "control_steps": self.steps,
        }

    def _notice(self) -> None:
        """Remember where the camera was, and which frame was looked at last."""
        camera = self.info["camera"]
        self._track.append((camera["time_s"], self.camera_to_world))
        if self._looked is None or camera["frame"] != self._looked[0]:
            pose = min(self._track, key=lambda moment: abs(moment[0] - camera["captured_at_s"]))[1]
            self._looked = (camera["frame"], self.env.get_wrapper_attr("perception").estimate, pose)

    # ------------------------------------------------------------------ what there is to see

    @property
    def simulation(self) -> Simulation:
        """The physics."""
        simulation: Simulation = self.env.get_wrapper_attr("simulation")
        return simulation

    @property
    def time_s(self) -> float:
        """Since the flight began."""
        return self.steps * CONTROL_DT

    @property
    def camera_to_world(self) -> np.ndarray:
        """(4, 4) of the camera now."""
        pose: np.ndarray = base_to_world(self.env.get_wrapper_attr("state").after) @ self._camera_to_base
        return pose

    def true_edges(self) -> list[np.ndarray]:
        """(2, 3) ends of each true nosing, world frame, metres."""
        return nosings(self.stairs)

    def measured_stairs(self) -> list[np.ndarray]:
        """(n, 3) outlines of what the last frame measured, put where the camera was at its capture; world frame."""
        assert self._looked is not None
        _, estimate, pose = self._looked
        yaw = np.arctan2(pose[1, 2], pose[0, 2])  # of the optical axis
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        return [line @ turn.T + pose[:3, 3] for line in treads(estimate)] if estimate.valid else []

    def measured_edge(self) -> list[np.ndarray]:
        """(2, 3) where the stair block says that the next edge is; none when it knows of none."""
        hips = float(get_robot(self.config.robot).hip_x[0])
        return next_edge(self.block(), self.info["truth"], hips)

    def block(self) -> Mapping[str, float]:
        """The stair block that the agent reads."""
        return dict(zip(STAIR_FIELDS, self.observation["stair"].tolist()))

    def close(self) -> None:
        """Release the environment; safe to call twice."""
        self.env.close()
