"""RLlib: PPO on flattened observations; an environment of its own, for Ray asks for one version of Gymnasium."""

import gymnasium as gym
import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.tune.registry import register_env

ACTION_STD = 0.06  # RLlib begins with a deviation of 1, in which the gait falls before it learns


def make(config: dict) -> gym.Env:
    import stair_env  # noqa: F401  (in Ray's processes, too)

    env = gym.wrappers.FlattenObservation(gym.make("stair_env/StairClimb-v0", **config))
    return gym.wrappers.RescaleAction(env, -1 / ACTION_STD, 1 / ACTION_STD)


if __name__ == "__main__":
    ray.init(address="local", num_cpus=2, include_dashboard=False)  # its own, not one that happens to run here
    register_env("stairs", make)
    config = (
        PPOConfig()
        .environment("stairs", env_config={"max_episode_steps": 60}, normalize_actions=False, clip_actions=True)
        .env_runners(num_env_runners=0, rollout_fragment_length=64)
        .training(train_batch_size_per_learner=256, minibatch_size=64, num_epochs=2, lr=3e-4)
        .rl_module(model_config={"fcnet_hiddens": [64], "free_log_std": True, "vf_share_layers": False})
        .debugging(seed=0)
    )
    algorithm = config.build_algo()
    result = algorithm.train()
    runners = result["env_runners"]
    assert runners["num_env_steps_sampled"] >= 256, runners
    print(f"rllib: {runners['num_env_steps_sampled']} steps, mean return {runners['episode_return_mean']:.1f}")
    algorithm.stop()
    ray.shutdown()
