"""Gymnasium's RecordVideo, which needs moviepy: `pip install stair-env[video]`."""

import tempfile
from pathlib import Path

import gymnasium as gym
import numpy as np

import stair_env  # noqa: F401

with tempfile.TemporaryDirectory() as folder:
    env = gym.make("stair_env/StairClimbPerception-v0", render_mode="rgb_array", max_episode_steps=10)
    env = gym.wrappers.RecordVideo(env, folder)
    env.reset(seed=0)
    for _ in range(10):
        env.step(np.zeros(16, np.float32))
    env.close()
    video = next(Path(folder).glob("*.mp4"))
    print(f"{video.name}: {video.stat().st_size} bytes")
