"""skrl: PPO over `gym.make_vec`; its wrapper hands its models the flattened observation."""

import tempfile

import gymnasium as gym
import torch
from skrl.agents.torch import ExperimentCfg
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer, SequentialTrainerCfg
from torch import nn

import stair_env  # noqa: F401

NUM_ENVS, ROLLOUT, STEPS = 2, 64, 128


def network(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, outputs))


class Actor(GaussianMixin, Model):
    def __init__(self, observation_space: gym.Space, action_space: gym.Space) -> None:
        Model.__init__(self, observation_space=observation_space, action_space=action_space, device="cpu")
        GaussianMixin.__init__(self, clip_actions=True)
        self.net = network(self.num_observations, self.num_actions)
        self.log_std = nn.Parameter(torch.full((self.num_actions,), -2.8))  # with more the gait falls before it learns

    def compute(self, inputs: dict[str, torch.Tensor], role: str = "") -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    def __init__(self, observation_space: gym.Space, action_space: gym.Space) -> None:
        Model.__init__(self, observation_space=observation_space, action_space=action_space, device="cpu")
        DeterministicMixin.__init__(self)
        self.net = network(self.num_observations, 1)

    def compute(self, inputs: dict[str, torch.Tensor], role: str = "") -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        return self.net(inputs["observations"]), {}


if __name__ == "__main__":
    # skrl takes each step for one of the episode, which the reset steps of Gymnasium's default mode are not.
    envs = gym.make_vec("stair_env/StairClimb-v0", num_envs=NUM_ENVS, autoreset_mode="SameStep", max_episode_steps=60)
    env = wrap_env(envs, wrapper="gymnasium")
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space}
    with tempfile.TemporaryDirectory() as folder:
        agent = PPO(
            models={"policy": Actor(**spaces), "value": Critic(**spaces)},
            memory=RandomMemory(memory_size=ROLLOUT, num_envs=NUM_ENVS, device="cpu"),
            cfg=PPO_CFG(
                rollouts=ROLLOUT,
                learning_epochs=2,
                learning_rate=3e-4,
                time_limit_bootstrap=True,
                experiment=ExperimentCfg(directory=folder, write_interval=0, checkpoint_interval=0),
            ),
            device="cpu",
            **spaces,
        )
        before = agent.policy.net[0].weight.clone()
        SequentialTrainer(
            env=env,
            agents=agent,
            cfg=SequentialTrainerCfg(
                timesteps=STEPS, headless=True, disable_progressbar=True, close_environment_at_exit=False
            ),
        ).train()
        change = (agent.policy.net[0].weight - before).abs().max().item()
    assert change > 0, "nothing was learned"
    print(f"skrl: {STEPS * NUM_ENVS} steps, weights moved by up to {change:.4f}")
    env.close()
