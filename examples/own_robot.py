"""A robot of one's own is an entry in a table: here an AlienGo that stands higher and looks further down.

python examples/own_robot.py
"""

import dataclasses

import gymnasium as gym
import numpy as np

import stair_env  # noqa: F401  (registers the environment ids)
from stair_env.robots import ROBOTS, CameraMount


def main() -> None:
    tall = dataclasses.replace(
        ROBOTS["aliengo"],
        name="aliengo_tall",
        stand_height=0.40,
        camera=CameraMount(position=(0.34, 0.0, 0.06), pitch_down_rad=0.55),
    )
    ROBOTS[tall.name] = tall  # do this where worker processes see it, in a module that they import

    env = gym.make("stair_env/StairClimb-v0", robot="aliengo_tall", riser_height=0.08, num_steps=4)
    for seed in range(3):
        env.reset(seed=seed)
        done = False
        while not done:  # zero action: the gait alone
            *_, terminated, truncated, info = env.step(np.zeros(env.action_space.shape, np.float32))
            done = terminated or truncated
        print(f"seed {seed}: {info.get('termination', 'time is up')}, {info['steps_climbed']} steps climbed")
    env.close()


if __name__ == "__main__":
    main()
