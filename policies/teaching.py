"""The gait as a teacher: which action of joint angles it would take where the student is.

The teacher knows the true staircase, whatever the student's stair block holds, and walks the same robot on the same
sensed state. It keeps a stride of its own, so it listens: when the student is early or late in its stride, the teacher
hurries or waits, and its advice fits the stride that the student is in.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np

from stair_env.common.constants import CONTROL_DT
from stair_env.observation import PROPRIO_SLICES, STAIR_FIELDS, StairBlock
from stair_env.onboard.gait import ACTION_SIZE, Gait
from stair_env.onboard.kinematics import LegKinematics
from stair_env.onboard.proprioception import base_to_level

TEACHER_KEY = "teacher_action"  # of the info
FREQUENCY = ACTION_SIZE - 2  # of the gait's action: factor on the stride's frequency
LISTENING = 0.3  # share of the phase error that the teacher tries to make good in a control step
HEARING = 0.3  # share of the newest in the phase error that it hears
EDGE_DOUBT_M = 0.04  # so near an edge the foot's height says on which side of it the foot stands
AGREEMENT = 0.25  # share of the way to the student's foothold that the teacher's goes in a control step
LOST = 0.12  # root mean square difference to the teacher's action, over half a second: beyond, no advice helps
LOSING = 0.05  # share of the newest in it
LEAST_MOTION_RAD = 0.02  # of the targets in a control step; slower ones do not tell the phase

_GRAVITY, _JOINTS = PROPRIO_SLICES["gravity"], PROPRIO_SLICES["joint_position"]
_VELOCITY = PROPRIO_SLICES["velocity"]


class ListeningGait(Gait):
    """A gait whose standing feet are where the student put them, on the tread that is there."""

    def agree(self, joint_targets: np.ndarray) -> None:
        """Take over where the student's feet stand.

        Args:
            joint_targets: (12,) that the student asked for, radians.
        """
        base = self._height + self.robot.stand_height
        cos, sin = math.cos(self._pitch), math.sin(self._pitch)
        for leg, (x, y, z) in enumerate(self._kinematics.foot_positions(joint_targets).tolist()):
            if self._in_swing[leg]:
                continue
            foot, forward, up = self._feet[leg], cos * x + sin * z, cos * z - sin * x + base  # in the walking frame
            s = self._along_stairs(forward, y)
            levels = self.map.height_at(s - EDGE_DOUBT_M), self.map.height_at(s + EDGE_DOUBT_M), foot[2]
            ground = min(levels, key=lambda level: abs(level - up))
            for axis, value in enumerate((forward, y, ground)):
                foot[axis] += AGREEMENT * (value - foot[axis])


class Teaching(gym.Wrapper[Any, np.ndarray, Any, np.ndarray]):
    """Puts into `info["teacher_action"]` what the gait would do on the observation beside it.

    Args:
        env: a climbing environment with actuation="joint"; its planner says which angles an action means.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        base: Any = env.unwrapped
        self._gait = ListeningGait(base.robot)
        self._kinematics = LegKinematics(base.robot)
        self._actions = base.gait
        self._frequency = self._gait.config.frequency_range

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; the teacher always begins with the same legs, which a student can learn."""
        observation, info = self.env.reset(seed=seed, options=options)
        proprio = observation["proprio"]
        level = base_to_level(-proprio[_GRAVITY])
        heights = self._kinematics.foot_positions(proprio[_JOINTS]) @ level[2]
        down_x, _, down_z = proprio[_GRAVITY].tolist()
        self._gait.reset(heights - heights[0], phase=0.0, pitch=float(np.arctan2(down_x, -down_z)))
        self._advice = self._last_advice = np.asarray(self._actions.action_for(proprio[_JOINTS]))
        self._ahead = self._gap = 0.0
        return observation, self._teach(observation, info)

    def step(self, action: np.ndarray) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """One control step with the student's action; an episode in which the student is lost is cut short."""
        self._listen(np.asarray(action, np.float64))
        observation, reward, terminated, truncated, info = self.env.step(action)
        truncated = truncated or self._gap > LOST**2
        return observation, reward, terminated, truncated, self._teach(observation, info)

    def _listen(self, action: np.ndarray) -> None:
        """How many control steps the student is ahead of the teacher (negative: behind), along the teacher's motion."""
        self._gap += LOSING * (float(np.mean((action - self._advice) ** 2)) - self._gap)
        motion = self._advice - self._last_advice
        speed = float(motion @ motion)
        ahead = float((action - self._advice) @ motion) / max(speed, LEAST_MOTION_RAD**2)
        self._ahead += HEARING * (min(max(ahead, -3.0), 3.0) - self._ahead)
        self._gait.agree(self._actions.pose + self._actions.scale * action)

    def _teach(self, observation: Mapping[str, np.ndarray], info: dict[str, Any]) -> dict[str, Any]:
        modulation = np.zeros(ACTION_SIZE)
        modulation[FREQUENCY] = min(max(LISTENING * self._ahead / self._frequency, -1.0), 1.0)
        truth = info["truth"]
        block = StairBlock(*(float(truth[name]) for name in STAIR_FIELDS))
        velocity = observation["proprio"][_VELOCITY].astype(np.float64)
        targets = self._gait.joint_targets(modulation, block, velocity, CONTROL_DT)
        self._last_advice, self._advice = self._advice, self._actions.action_for(targets)
        info[TEACHER_KEY] = np.clip(self._advice, -1.0, 1.0).astype(np.float32)
        return info
