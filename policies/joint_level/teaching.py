"""The gait as a teacher: which action of joint angles it would take where the student is.

The teacher knows the true staircase, whatever the student's stair block holds, and walks the same robot on the same
sensed state. It keeps a stride of its own, so it listens: when the student is early or late in its stride, the teacher
hurries or waits, and its advice fits the stride that the student is in. A student whose observation holds a clock
(`actuation={"clock_hz": ...}`) is taught to stride with it instead.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np

from policies.stances import STANCES, Stance
from stair_env.common.constants import CONTROL_DT
from stair_env.observation import PROPRIO_SLICES, STAIR_FIELDS, StairBlock
from stair_env.onboard.gait import ACTION_SIZE, REFERENCE_HEIGHT_M, Gait, GaitAction, GaitConfig
from stair_env.onboard.kinematics import LegKinematics
from stair_env.onboard.proprioception import base_to_level

TEACHERS = ("gait", "stance")
TEACHER_KEY = "teacher_action"  # of the info
FREQUENCY = ACTION_SIZE - 2  # of the gait's action: factor on the stride's frequency
LISTENING = 0.3  # share of the phase error that the teacher tries to make good in a control step
MOST_HURRY = 0.2  # change of the stride's frequency to that end
FREQUENCY_RANGE = 0.4  # of the teaching gait: a stance's own frequency and the hurry
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
        modulation = GaitAction.from_array(self._action, self.config)
        base = self._height + self.robot.stand_height
        pitch = self._pitch + modulation.pitch
        cos, sin = math.cos(pitch), math.sin(pitch)
        feet = self._kinematics.foot_positions(joint_targets) - modulation.feet
        for leg, (x, y, z) in enumerate(feet.tolist()):
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
        stance: "gait" teaches the bare gait, "stance" the gait in the robot's stances of `policies.stances.STANCES`.

    Raises:
        ValueError: no such teacher, or none for this robot.
    """

    def __init__(self, env: gym.Env[Any, Any], stance: str = "gait") -> None:
        super().__init__(env)
        base: Any = env.unwrapped
        self._keeps_time = base.gait.config.clock_hz > 0.0
        config = _gait_numbers(base.gait.config.clock_hz * math.sqrt(base.robot.stand_height / REFERENCE_HEIGHT_M))
        self._up, self._down = _modulations(stance, base.robot.name, config)
        self._gait = ListeningGait(base.robot, config)
        self._kinematics = LegKinematics(base.robot)
        self._actions = base.gait

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; without a clock the teacher always begins with the same legs, which a student can learn."""
        observation, info = self.env.reset(seed=seed, options=options)
        proprio = observation["proprio"]
        level = base_to_level(-proprio[_GRAVITY])
        heights = self._kinematics.foot_positions(proprio[_JOINTS]) @ level[2]
        down_x, _, down_z = proprio[_GRAVITY].tolist()
        self._gait.reset(heights - heights[0], phase=self._actions.phase, pitch=float(np.arctan2(down_x, -down_z)))
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
        truth = info["truth"]
        block = StairBlock(*(float(truth[name]) for name in STAIR_FIELDS))
        modulation = (self._down if self._gait.map.direction < 0 else self._up).copy()
        if self._keeps_time:
            modulation[FREQUENCY] = 0.0
            self._gait.phase = self._actions.phase
        else:
            hurry = min(max(LISTENING * self._ahead, -MOST_HURRY), MOST_HURRY)
            modulation[FREQUENCY] = min(max(modulation[FREQUENCY] + hurry / FREQUENCY_RANGE, -1.0), 1.0)
        velocity = observation["proprio"][_VELOCITY].astype(np.float64)
        targets = self._gait.joint_targets(modulation, block, velocity, CONTROL_DT)
        self._last_advice, self._advice = self._advice, self._actions.action_for(targets)
        info[TEACHER_KEY] = np.clip(self._advice, -1.0, 1.0).astype(np.float32)
        return info


def _gait_numbers(clock_hz: float) -> GaitConfig:
    """Of the teaching gait; a student with a clock is taught to stride with that, up and down."""
    config = GaitConfig(frequency_range=FREQUENCY_RANGE)
    if not clock_hz:
        return config
    level, down = (replace(style, frequency_hz=clock_hz) for style in (config.level, config.down))
    return replace(config, level=level, down=down)


def _modulations(stance: str, robot: str, config: GaitConfig) -> tuple[np.ndarray, np.ndarray]:
    """Actions (16,) of the teaching gait up and down."""
    if stance not in TEACHERS:
        raise ValueError(f"teacher={stance!r} must be one of {', '.join(TEACHERS)}")
    if stance == "gait":
        up = down = Stance()
    elif robot in STANCES:
        up, down = STANCES[robot]
    else:
        raise ValueError(f"no stances are known for robot {robot!r}, only for {', '.join(STANCES)}")
    return up.action(config).astype(np.float64), down.action(config).astype(np.float64)
