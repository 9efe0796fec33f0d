"""What a robot without a gait has to keep in mind: how it moved a moment ago, and the edges its front feet have passed.

A policy that asks for joint angles has neither clock nor foothold plan. Where in its stride it is shows in what it did
in the last third of a second; what lies under the rear feet, in the stair blocks of the last second. `Memory` keeps
both and reads nothing but the observation, whichever source filled its stair block.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from stair_env.common.constants import CONTROL_DT
from stair_env.observation import NO_STAIRS, PROPRIO_SLICES, StairBlock
from stair_env.onboard.kinematics import LegKinematics
from stair_env.onboard.proprioception import base_to_level
from stair_env.onboard.step_map import StepMap
from stair_env.robots import NUM_JOINTS, RobotSpec

MEMORY_KEY, STAIR_KEY = "memory", "stair"  # of the observation
LAGS = (1, 2, 4, 7, 11, 16)  # control steps ago; a stride of the trot that teaches takes 12 to 16 of them
MOMENT_FIELDS = ("last_action", "velocity", "gravity", "yaw_rate", "contact")  # of the proprioception
AXLE_FIELDS = ("behind_distance", "behind_rise", "ahead_distance", "ahead_rise")  # of the nearest edge on each side
MOMENT_SIZE = NUM_JOINTS + 3 + 3 + 1 + 4
EDGES_SIZE = 2 * len(AXLE_FIELDS) + 1  # front hips, rear hips, and the ground's height between the two
FOOT_FIELDS = ("ahead_of_hip", "height", "behind_distance", "ahead_distance", "ground")
FEET_SIZE = 4 * len(FOOT_FIELDS)
EDGES = slice(len(LAGS) * MOMENT_SIZE, len(LAGS) * MOMENT_SIZE + EDGES_SIZE)  # where in the memory they are
FEET = slice(EDGES.stop, EDGES.stop + FEET_SIZE)
MEMORY_SIZE = FEET.stop
MEMORY_BOUND = 2 * math.pi
FAR_M = 0.6  # an edge farther away than this is as good as none
HEADING_MEMORY_S = 0.5  # a heading error that is no longer measured fades with this time constant

_ACTION = PROPRIO_SLICES["last_action"].start
_GRAVITY, _VELOCITY, _JOINTS = (PROPRIO_SLICES[name] for name in ("gravity", "velocity", "joint_position"))
_REMEMBERED = np.concatenate(
    [np.arange(_ACTION, _ACTION + NUM_JOINTS)]
    + [np.arange(PROPRIO_SLICES[name].start, PROPRIO_SLICES[name].stop) for name in MOMENT_FIELDS[1:]]
)


class Memory:
    """Remembers one robot's episode, one observation at a time.

    Args:
        robot: supplies hips and kinematics.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._hip_x = robot.hip_x
        self._hips = robot.hips
        self._kinematics = LegKinematics(robot)
        self._map = StepMap()
        self._moments: deque[np.ndarray] = deque(maxlen=max(LAGS) + 1)

    def begin(self, observation: Mapping[str, np.ndarray]) -> np.ndarray:
        """Forget everything, and take in the first observation of an episode; returns as `update`."""
        self._map.reset()
        self._heading_error = 0.0
        self._heard = False
        self._moments.clear()
        self._moments.extend([_moment(observation["proprio"])] * (max(LAGS) + 1))
        return self._recall(observation)

    def update(self, observation: Mapping[str, np.ndarray]) -> np.ndarray:
        """Take in the next observation.

        Args:
            observation: `proprio`, whose last action has twelve numbers, and `stair`; without that, no edges are known.

        Returns:
            (MEMORY_SIZE,) float32: the moments at LAGS, each of MOMENT_FIELDS; then for the front
            and the rear hips AXLE_FIELDS, metres, FAR_M and 0 where there is no edge; then how far the ground under
            the front hips lies above that under the rear ones, metres; then FOOT_FIELDS of each foot (`place_feet`).
        """
        self._moments.append(_moment(observation["proprio"]))
        forward, left = observation["proprio"][_VELOCITY][:2].tolist()
        along = forward * math.cos(self._heading_error) + left * math.sin(self._heading_error)
        self._map.advance(along * CONTROL_DT, CONTROL_DT)
        return self._recall(observation)

    def _recall(self, observation: Mapping[str, np.ndarray]) -> np.ndarray:
        block = StairBlock(*observation[STAIR_KEY].tolist()) if STAIR_KEY in observation else NO_STAIRS
        if block.valid >= 0.5:
            self._heading_error = block.heading_error
        else:
            self._heading_error *= math.exp(-CONTROL_DT / HEADING_MEMORY_S)
        down_x, _, down_z = observation["proprio"][_GRAVITY].tolist()
        laid_flat = math.cos(math.atan2(down_x, -down_z)) * math.cos(self._heading_error)
        front, rear = self._hip_x[0] * laid_flat, self._hip_x[1] * laid_flat
        self._map.observe(block, front)
        if not self._heard and block.valid >= 0.5:
            self._heard = True
            self._map.assume_on_flight(self._front_above_rear(observation["proprio"]))
        edges = self._map.edges()
        climb = self._map.height_at(front) - self._map.height_at(rear)
        recent = [self._moments[-1 - lag] for lag in LAGS]
        axles = np.array([*_nearest(edges, front), *_nearest(edges, rear), climb], np.float32)
        feet = place_feet(self._kinematics, self._hips, observation["proprio"], block, axles)
        recalled = np.concatenate([*recent, axles, feet], dtype=np.float32)
        np.minimum(recalled, MEMORY_BOUND, out=recalled)
        return np.maximum(recalled, -MEMORY_BOUND, out=recalled)

    def _front_above_rear(self, proprio: np.ndarray) -> float:
        """How far the front feet stand above the rear ones, metres."""
        level = base_to_level(-proprio[_GRAVITY])
        heights = self._kinematics.foot_positions(proprio[_JOINTS]) @ level[2]
        return float(heights[:2].mean() - heights[2:].mean())


def place_feet(
    kinematics: LegKinematics, hips: np.ndarray, proprio: np.ndarray, block: StairBlock, axles: np.ndarray
) -> np.ndarray:
    """Where the feet are on the stairs.

    Args:
        kinematics: of the robot.
        hips: (4, 3) in the base frame, metres.
        proprio: the proprioceptive block.
        block: the stair block, for the heading.
        axles: (EDGES_SIZE,) edges near front and rear hips.

    Returns:
        (FEET_SIZE,) for each foot: how far it is ahead of its hip along the stairs, its height over the hip (negative),
        the distances to the last edge behind it and to the next one ahead, FAR_M where there is none, and how far the
        ground under it lies above that under its hip; metres.
    """
    level = base_to_level(-proprio[_GRAVITY])
    away = (kinematics.foot_positions(proprio[_JOINTS]) - hips) @ level.T
    heading = block.heading_error if block.valid >= 0.5 else 0.0
    along = away[:, 0] * math.cos(heading) + away[:, 1] * math.sin(heading)
    places = []
    for leg, (s, height) in enumerate(zip(along.tolist(), away[:, 2].tolist())):
        back, back_rise, front, front_rise = axles[:4].tolist() if leg < 2 else axles[4:8].tolist()
        behind = s + back if back_rise else FAR_M
        ahead, ground = front - s if front_rise else FAR_M, 0.0
        if behind < 0.0:  # the foot is on the near side of the edge behind the hip
            behind, ahead, ground = FAR_M, -behind, -back_rise
        elif ahead < 0.0:
            behind, ahead, ground = -ahead, FAR_M, front_rise
        places += [s, height, behind, ahead, ground]
    return np.array(places, np.float32)


def _moment(proprio: np.ndarray) -> np.ndarray:
    """(MOMENT_SIZE,) what is remembered of a control step."""
    moment: np.ndarray = proprio[_REMEMBERED]
    return moment


def _nearest(edges: list[tuple[float, float]], s: float) -> list[float]:
    """AXLE_FIELDS at a position, metres."""
    behind, ahead = [FAR_M, 0.0], [FAR_M, 0.0]
    for edge_s, rise in edges:
        distance = edge_s - s
        if -FAR_M < distance <= 0.0:
            behind = [-distance, rise]
        elif 0.0 < distance < FAR_M:
            ahead = [distance, rise]
            break
    return behind + ahead
