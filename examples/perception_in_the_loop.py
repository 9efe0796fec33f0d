"""The same flights twice: once the policy is told the true stairs, once it has to look.

python examples/perception_in_the_loop.py --episodes 5
"""

import argparse

import gymnasium as gym

import stair_env  # noqa: F401  (registers the environment ids)
from policies import pretrained


def climb(env_id: str, policy_name: str, episodes: int) -> list[bool]:
    env = gym.make(env_id, direction="up", riser_height=[0.10, 0.14])
    policy = pretrained.load(policy_name, env)
    outcomes = []
    for seed in range(episodes):
        observation, info = env.reset(seed=seed)
        done = False
        while not done:
            action, _ = policy.predict(observation)
            observation, _, terminated, truncated, info = env.step(action)
            done = terminated or truncated
        outcomes.append(info["is_success"])
    env.close()
    return outcomes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--policy", default="aliengo")
    parser.add_argument("--episodes", type=int, default=5)
    args = parser.parse_args()
    for env_id in ("stair_env/StairClimb-v0", "stair_env/StairClimbPerception-v0"):
        outcomes = climb(env_id, args.policy, args.episodes)
        print(f"{env_id:<36} climbed {sum(outcomes)} of {len(outcomes)}")


if __name__ == "__main__":
    main()
