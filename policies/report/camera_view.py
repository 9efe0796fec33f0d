"""What the robot's camera saw last, with the lines found in it."""

from __future__ import annotations

import gymnasium as gym
import numpy as np

FRAME_ATTRIBUTE, PERCEPTION_ATTRIBUTE = "last_rgb", "perception"  # of perception.wrapper.PerceptionWrapper


def camera_view(env: gym.Env) -> np.ndarray | None:
    """The newest camera frame with its lines, uint8 (H, W, 3); None for a robot that does not look, or not yet."""
    if not env.has_wrapper_attr(FRAME_ATTRIBUTE) or env.get_wrapper_attr(FRAME_ATTRIBUTE) is None:
        return None
    from perception.drawing import draw_estimate

    drawn: np.ndarray = draw_estimate(
        env.get_wrapper_attr(FRAME_ATTRIBUTE), env.get_wrapper_attr(PERCEPTION_ATTRIBUTE).estimate
    )
    return drawn
