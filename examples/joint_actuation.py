"""Without the gait: twelve joint offsets are the action, and PPO starts from nothing.

python examples/joint_actuation.py --timesteps 100000
"""

import argparse

import gymnasium as gym
from stable_baselines3 import PPO

import stair_env  # noqa: F401  (registers the environment ids)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--timesteps", type=int, default=100_000)
    args = parser.parse_args()
    env = gym.make("stair_env/StairClimb-v0", actuation="joint", riser_height=[0.02, 0.06], curriculum=True)
    model = PPO("MultiInputPolicy", env, n_steps=1024, batch_size=256, device="cpu", verbose=1)
    model.learn(args.timesteps)
    env.close()


if __name__ == "__main__":
    main()
