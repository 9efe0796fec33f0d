"""What a control step did, as the simulator knows it: what reward terms, terminations and observation terms read.

None of it reaches a policy unless an observation term hands it over (see `stair_env.task.observation_terms`).
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stair_env.observation import StairBlock
from stair_env.physics.simulation import BaseState, FootContacts, RobotReading
from stair_env.robots import RobotSpec
from stair_env.stairs import StairProfile, StairSpec
from stair_env.task.randomization import Body

FAILURES = ("fall", "left_flight", "walked_away")
RISER_HIT_MIN_N = 5.0  # a lighter touch is none
RISER_HIT_RATIO = 4.0  # a foot that is pushed sideways this much harder than it is carried has hit a riser


WANTED_SPEED = 0.35  # m/s; where nothing else is commanded


class Command(NamedTuple):
    """A velocity to follow, frame that turns with the base.

    Attributes:
        forward, lateral: m/s, lateral positive to the left.
        turn: rad/s, positive to the left.
    """

    forward: float = WANTED_SPEED
    lateral: float = 0.0
    turn: float = 0.0


NO_COMMAND = Command()


@dataclass(frozen=True, eq=False)
class Episode:
    """What stays the same for an episode.

    Attributes:
        stairs: the staircase.
        profile: its side view, ground height by x.
        robot: who climbs.
        body: what was drawn about the robot's body and the ground: friction, payload (kg), motor strength.
        start_x: where the base began, world frame, metres.
        seed: for terms that draw, the same for equal episodes.
    """

    stairs: StairSpec
    profile: StairProfile
    robot: RobotSpec
    body: Body
    start_x: float
    seed: int = 0


class StepState(NamedTuple):
    """One control step. Nothing of it can be changed: the fields are frozen and the arrays read-only.

    Legs in the order FR, FL, RR, RL, three joints each (hip, upper, lower). The world frame is that of the stairs: x
    along the walking direction from the first edge, y left, z up from the lowest floor. At a reset the step has no
    length: `before` is `after`, and the actions are zero.

    Attributes:
        episode: what stays the same: stairs, profile, robot, body, start_x.
        time_s: since the episode began, at the end of the step.
        dt_s: length of the control step.
        before, after: of the base at the start and the end of the step, world frame: position (3,) m, rotation (3, 3)
            base to world, velocity (3,) m/s, angular_velocity (3,) rad/s, yaw rad.
        joint_positions: (12,) canonical angles, rad.
        joint_velocities: (12,) rad/s.
        joint_torques: (12,) of the motors in the last physics step, N·m.
        joint_targets: (12,) what the planner asked for, rad.
        feet, previous_feet: (4, 3) foot centres at the end and the start of the step, world frame, m.
        contacts: of the feet at the end of the step: touching (4,) bool, force (4, 3) of the ground on each foot, world
            frame, N; body_touches, whether another part of the robot touches something.
        riser_hits: number of feet that run into something upright.
        action, previous_action: (n,) float64 in [-1, 1].
        truth: the true stair block.
        block: the stair block that the gait reads, true or not.
        ground_under_feet: height of the ground under each of the four feet, world frame, m.
        ground_under_base: height of the ground under the base, world frame, m.
        steps_climbed: most edges that the base has had behind it in this episode.
        new_steps: how many of them since the step before.
        termination: name of the termination that ended the episode with this step, else empty.
        command: velocity to follow; WANTED_SPEED forward where the environment draws none.
    """

    episode: Episode
    time_s: float
    dt_s: float
    before: BaseState
    after: BaseState
    joint_positions: np.ndarray
    joint_velocities: np.ndarray
    joint_torques: np.ndarray
    joint_targets: np.ndarray
    feet: np.ndarray
    previous_feet: np.ndarray
    contacts: FootContacts
    riser_hits: int
    action: np.ndarray
    previous_action: np.ndarray
    truth: StairBlock
    block: StairBlock
    ground_under_feet: tuple[float, float, float, float]
    ground_under_base: float
    steps_climbed: int
    new_steps: int
    termination: str = ""
    command: Command = NO_COMMAND

    @property
    def foot_velocities(self) -> np.ndarray:
        """(4, 3) mean velocity of each foot over the step, world frame, m/s."""
        return (self.feet - self.previous_feet) / self.dt_s

    @property
    def joint_power_w(self) -> float:
        """Mechanical power of all joints, braking counted as work, W."""
        return float(np.dot(np.abs(self.joint_torques), np.abs(self.joint_velocities)))

    @property
    def slope_rad(self) -> float:
        """Slope of the ground under the feet, positive where it rises ahead."""
        front_right, front_left, rear_right, rear_left = self.ground_under_feet
        front, rear = self.episode.robot.hip_x
        return math.atan2((front_right + front_left - rear_right - rear_left) / 2, front - rear)

    @property
    def edge_distances(self) -> tuple[float, ...]:
        """Horizontal distance from each of the four feet to the nearest stair edge, m."""
        edges = self.episode.profile.plain[0]
        return tuple(distance_to_edge(edges, x) for x in self.feet[:, 0].tolist())


class StepRecorder:
    """Makes the StepState of each control step of an episode.

    Args:
        episode: stairs, robot and body.
        action_size: length of the action.
    """

    def __init__(self, episode: Episode, action_size: int) -> None:
        self.episode = episode
        self._edges, self._levels = episode.profile.plain
        self._no_action = np.zeros(action_size)

    def begin(
        self,
        base: BaseState,
        reading: RobotReading,
        targets: np.ndarray,
        truth: StairBlock,
        block: StairBlock,
        dt: float,
        command: Command = NO_COMMAND,
    ) -> StepState:
        """Return the state of a robot that stands, before the first control step.

        Args:
            base: state of the base.
            reading: joints and feet.
            targets: (12,) joint angles that the motors hold, radians.
            truth, block: stair block, true and as the gait reads it.
            dt: length of a control step, seconds.
            command: velocity to follow.
        """
        self._steps_climbed = self._edges_behind(base)
        self._last_base, self._last_feet, self._last_action = base, reading.feet, self._no_action
        return self.record(0.0, base, reading, targets, self._no_action, truth, block, dt, command)

    def record(
        self,
        time_s: float,
        base: BaseState,
        reading: RobotReading,
        targets: np.ndarray,
        action: np.ndarray,
        truth: StairBlock,
        block: StairBlock,
        dt: float,
        command: Command = NO_COMMAND,
    ) -> StepState:
        """Return the state at the end of a control step; the arrays handed over are read-only from here on.

        Args:
            time_s: since the episode began.
            base: state of the base.
            reading: joints and feet.
            targets: (12,) planned joint angles, radians.
            action: (n,) in [-1, 1].
            truth, block: stair block, true and as the gait reads it.
            dt: length of the control step, seconds.
            command: velocity to follow.
        """
        before, previous_feet, previous_action = self._last_base, self._last_feet, self._last_action
        self._last_base, self._last_feet, self._last_action = base, reading.feet, action
        steps_climbed = max(self._steps_climbed, self._edges_behind(base))
        new_steps, self._steps_climbed = steps_climbed - self._steps_climbed, steps_climbed
        for array in (*reading.contacts[:2], reading.feet, *reading[:3], targets, action):
            array.setflags(write=False)
        edges, levels = self._edges, self._levels
        right, left, rear_right, rear_left = [levels[bisect_right(edges, x)] for x in reading.feet[:, 0].tolist()]
        return StepState(
            episode=self.episode,
            time_s=time_s,
            dt_s=dt,
            before=before,
            after=base,
            joint_positions=reading.joint_positions,
            joint_velocities=reading.joint_velocities,
            joint_torques=reading.joint_torques,
            joint_targets=targets,
            feet=reading.feet,
            previous_feet=previous_feet,
            contacts=reading.contacts,
            riser_hits=sum(riser_hits(reading.contacts)),
            action=action,
            previous_action=previous_action,
            truth=truth,
            block=block,
            ground_under_feet=(right, left, rear_right, rear_left),
            ground_under_base=levels[bisect_right(edges, float(base.position[0]))],
            steps_climbed=steps_climbed,
            new_steps=new_steps,
            command=command,
        )

    def _edges_behind(self, base: BaseState) -> int:
        return bisect_left(self._edges, float(base.position[0]))


def distance_to_edge(edge_x: list[float], x: float) -> float:
    """Return the horizontal distance from x to the nearest of ascending edges, metres."""
    ahead = bisect_left(edge_x, x)
    behind = edge_x[ahead - 1] if ahead else edge_x[0]
    return min(abs(behind - x), abs(edge_x[min(ahead, len(edge_x) - 1)] - x))


def riser_hits(contacts: FootContacts) -> list[bool]:
    """Which of the four feet run into something upright."""
    return [
        touches and math.hypot(x, y) > max(RISER_HIT_RATIO * abs(z), RISER_HIT_MIN_N)
        for touches, (x, y, z) in zip(contacts.touching.tolist(), contacts.force.tolist())
    ]
