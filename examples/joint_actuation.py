"""Without the gait: twelve joint offsets are the action, PD control makes torques of them, and PPO starts from nothing.

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
    rewards = {"track_velocity": 1.0, "torque": 2e-5, "foot_slip": 0.1, "air_time": 1.0, "smoothness": 0.01}
    env = gym.make(
        "stair_env/StairClimb-v0",
        actuation="joint",  # or {"scale": [0.3, 0.8, 0.8], "clock_hz": 2.4}
        actuator="pd",  # or {"kp": 150.0, "kd": 2.5}, or "position" for Bullet's motors
        observations="stairs",  # or "height_scan", or "proprio"
        command=[0.2, 0.5],
        rewards=rewards,
        riser_height=[0.02, 0.06],
        curriculum=True,
    )
    model = PPO("MultiInputPolicy", env, n_steps=1024, batch_size=256, device="cpu", verbose=1)
    model.learn(args.timesteps)
    env.close()


if __name__ == "__main__":
    main()
