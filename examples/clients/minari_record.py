"""Minari: record episodes with their infos, and read them and the environment back."""

import os
import tempfile

import gymnasium as gym
import numpy as np

import stair_env  # noqa: F401

with tempfile.TemporaryDirectory() as folder:
    os.environ["MINARI_DATASETS_PATH"] = folder
    import minari

    env = minari.DataCollector(gym.make("stair_env/StairClimb-v0", max_episode_steps=40), record_infos=True)
    for seed in range(2):
        env.reset(seed=seed)
        ended = False
        while not ended:
            _, _, terminated, truncated, _ = env.step(np.zeros(16, np.float32))
            ended = terminated or truncated
    env.create_dataset("stairs/gait-v0", algorithm_name="gait", description="the gait alone", eval_env=None)
    env.close()
    data = minari.load_dataset("stairs/gait-v0")
    for episode in data.iterate_episodes():
        heights = episode.infos["truth"]["riser_height"]
        print(f"episode {episode.id}: {len(episode)} steps, riser {heights[0]:.3f} m, {sorted(episode.infos)}")
    data.recover_environment().close()
