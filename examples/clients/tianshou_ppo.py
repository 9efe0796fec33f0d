"""Tianshou: PPO on flattened observations (its critic reads one vector)."""

import gymnasium as gym
import torch
from tianshou.algorithm import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OnPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic
from torch.distributions import Independent, Normal

import stair_env  # noqa: F401


def make() -> gym.Env:
    return gym.wrappers.FlattenObservation(gym.make("stair_env/StairClimb-v0", max_episode_steps=60))


env = make()
shape = env.observation_space.shape
actor = ContinuousActorProbabilistic(
    preprocess_net=Net(state_shape=shape, hidden_sizes=[64]), action_shape=env.action_space.shape, unbounded=True
)
torch.nn.init.constant_(actor.sigma_param, -2.8)  # with more noise the gait falls before it learns
policy = ProbabilisticActorPolicy(
    actor=actor,
    dist_fn=lambda parameters: Independent(Normal(*parameters), 1),
    action_space=env.action_space,
    action_scaling=False,
    action_bound_method="clip",
)
critic = ContinuousCritic(preprocess_net=Net(state_shape=shape, hidden_sizes=[64]))
algorithm = PPO(policy=policy, critic=critic, optim=AdamOptimizerFactory(lr=3e-4))
result = algorithm.run_training(
    OnPolicyTrainerParams(
        training_collector=Collector(algorithm, DummyVectorEnv([make] * 2), VectorReplayBuffer(1024, 2)),
        test_collector=Collector(algorithm, DummyVectorEnv([make])),
        max_epochs=1,
        epoch_num_steps=256,
        collection_step_num_env_steps=128,
        batch_size=64,
        update_step_num_repetitions=1,
        test_step_num_episodes=1,
    )
)
print(f"tianshou: best return {result.best_reward:.1f}")
