"""Gymnasium stair climbing for legged robots with a simulated RealSense D435i.

Importing this package registers the environments; nothing heavy is loaded until one is made. What runs on a robot needs
no Gymnasium: then it is not loaded, and the ids are registered as soon as somebody else imports it.
"""

from __future__ import annotations

from typing import Any

from stair_env.common import moved
from stair_env.common.importing import late_import, shadowing

__version__ = "0.1.0"

MAX_EPISODE_STEPS = 1200  # 25 s at 48 Hz
_ENTRY_POINTS: dict[str, dict[str, Any]] = {
    "stair_env/StairClimb-v0": {
        "entry_point": "stair_env.env:StairClimbEnv",
        "vector_entry_point": "stair_env.vector:make_climb_vec",
    },
    "stair_env/StairClimbRGBD-v0": {
        "entry_point": "stair_env.rgbd:StairClimbRgbdEnv",
        "vector_entry_point": "stair_env.vector:make_rgbd_vec",
    },
    "stair_env/StairClimbPerception-v0": {
        "entry_point": "stair_env.entry_points:make_perception_env",
        "vector_entry_point": "stair_env.entry_points:make_perception_vec",
    },
}
ENV_IDS = tuple(_ENTRY_POINTS)


def register_envs() -> None:
    """Register the environment ids with Gymnasium; calling it again changes nothing."""
    import gymnasium

    for env_id, spec in _ENTRY_POINTS.items():
        if env_id not in gymnasium.registry:
            gymnasium.register(id=env_id, max_episode_steps=MAX_EPISODE_STEPS, **spec)


moved.install(__name__)
shadowing.install()
late_import.when_imported("gymnasium", register_envs)
