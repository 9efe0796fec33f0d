"""TorchRL: its readers put infos into tensors, which takes flat ones (`stair_env.flat_info.FlatInfo`)."""

import gymnasium as gym
from gymnasium.vector import AsyncVectorEnv
from torchrl.envs import GymEnv, GymWrapper

from stair_env.flat_info import FlatInfo

ENV_ID = "stair_env/StairClimb-v0"


def make() -> gym.Env:
    return FlatInfo(gym.make(ENV_ID))


if __name__ == "__main__":
    print("plain:", GymEnv(ENV_ID).rollout(5).batch_size)
    one = GymWrapper(make()).auto_register_info_dict()
    rollout = one.rollout(5)
    print("with infos:", rollout["next", "truth_yaw"].shape)
    one.close()
    two = GymWrapper(AsyncVectorEnv([make, make], autoreset_mode="Disabled"))  # TorchRL resets by itself
    print("two in processes:", two.rollout(5)["next", "reward"].shape)
    two.close()
    workers = GymWrapper(gym.make_vec(ENV_ID, num_envs=2, autoreset_mode="Disabled"))
    print("two in our workers:", workers.rollout(5)["next", "reward"].shape)
    workers.close()
