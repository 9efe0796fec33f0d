"""The camera in the place of the oracle: RGB-D observations in, the stair block out.

`PerceptionWrapper` reads nothing but what a robot's computer would: joints and contacts through the proprioceptive
block, the IMU, colour and depth, and the camera's time stamps. What it makes of them goes into the observation and
back to the environment, whose gait reads the same block.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from perception.estimator import StairEstimator
from perception.geometry.results import StairEstimate
from perception.tracking.stair_perception import StairPerception
from perception.tracking.tracker import StairTracker
from stair_env.observation import StairBlock, stair_space

CONSUMED_KEYS = ("imu", "rgb", "depth")
NEEDED_KEYS = ("proprio", *CONSUMED_KEYS)
REPORTED_STEPS = 8  # rows of `info["perceived"]["steps_mm"]`: more are never in view


class PerceptionWrapper(gym.Wrapper[dict[str, np.ndarray], np.ndarray, dict[str, np.ndarray], np.ndarray]):
    """Turns `StairClimbRGBD-v0` into an environment with the spaces of `StairClimb-v0`.

    `info["perceived"]` holds the block, the last frame's estimate and its number; the truth stays under
    `info["truth"]`, for scoring only.

    Args:
        env: an RGBD environment whose stair_source is "external".
        estimator: None loads StairNetV2 0.25x.
        tracker: None makes one for the environment's robot.

    Raises:
        ValueError: the environment's observations lack what perception needs.
    """

    def __init__(
        self, env: gym.Env[Any, Any], estimator: StairEstimator | None = None, tracker: StairTracker | None = None
    ) -> None:
        super().__init__(env)
        parts = env.observation_space.spaces if isinstance(env.observation_space, spaces.Dict) else {}
        missing = [key for key in NEEDED_KEYS if key not in parts]
        if missing:
            raise ValueError(
                f"PerceptionWrapper needs observations with {', '.join(NEEDED_KEYS)}; {env} lacks {', '.join(missing)}"
            )
        self.observation_space = perceived_space(parts)
        self.estimator = estimator if estimator is not None else StairEstimator(refine_gravity=False)
        base: Any = env.unwrapped
        self.perception = StairPerception(base.robot, base.camera_intrinsics, tracker)
        self.last_rgb: np.ndarray | None = None  # the frame that `perception.geometry.results` speaks of; for pictures

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode, and look at its first frame."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.perception.reset(info["camera"]["time_s"])
        return self._perceive(observation, info), info

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], SupportsFloat, bool, bool, dict[str, Any]]:
        """One control step; the network runs when a new frame has arrived."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._perceive(observation, info), reward, terminated, truncated, info

    def _perceive(self, observation: dict[str, np.ndarray], info: dict[str, Any]) -> dict[str, np.ndarray]:
        camera, perception = info["camera"], self.perception
        perception.feel(observation["proprio"], observation["imu"], camera["time_s"])
        if perception.is_new(camera["frame"]):
            gravity = perception.gravity_at(camera["captured_at_s"])
            estimate = self.estimator.estimate(observation["rgb"], observation["depth"], perception.intrinsics, gravity)
            perception.look(estimate, camera["frame"], camera["captured_at_s"])
            self.last_rgb = observation["rgb"]
        block = perception.block()
        base: Any = self.env.unwrapped
        base.provide_stair(block)
        info["perceived"] = perceived_info(block, perception.estimate, camera["frame"])
        return perceived_observation(observation, block.as_array())


def perceived_space(parts: Mapping[str, spaces.Space[Any]]) -> spaces.Space[Any]:
    """Space of what is left of an RGBD observation: the sensors that perception reads are gone, the block is there."""
    kept = {key: space for key, space in parts.items() if key not in CONSUMED_KEYS}
    return spaces.Dict({**kept, "stair": stair_space()})


def perceived_observation(observation: Mapping[str, np.ndarray], block: np.ndarray) -> dict[str, np.ndarray]:
    """The observation that belongs to `perceived_space`; a leading batch dimension is kept."""
    kept = {key: value for key, value in observation.items() if key not in CONSUMED_KEYS}
    return {**kept, "stair": block}


def perceived_info(block: StairBlock, estimate: StairEstimate, frame: int) -> dict[str, Any]:
    """What `info["perceived"]` holds: the same keys, types and shapes at every step, equal for equal rollouts.

    `steps_mm` has a row (width, height) for each of the `steps` nearest steps, and rows of zeros after them.
    """
    steps = [[1000.0 * step.width_m, 1000.0 * step.height_m] for step in estimate.steps[:REPORTED_STEPS]]
    sizes = np.zeros((REPORTED_STEPS, 2))
    sizes[: len(steps)] = np.round(np.reshape(steps, (-1, 2)), 2)
    return {
        "block": block.as_array(),
        "frame": int(frame),
        "valid": bool(estimate.valid),
        "direction": int(estimate.direction),
        "steps": len(steps),
        "steps_mm": sizes,
        "next_edge_m": float(estimate.next_edge_m),
        "yaw_deg": math.degrees(estimate.yaw_rad),
    }
