"""sb3-contrib: TQC with our policy, and a policy with memory, saved and loaded again."""

import tempfile
from pathlib import Path

import gymnasium as gym
from sb3_contrib import TQC, RecurrentPPO

import stair_env  # noqa: F401
from policies import pretrained
from policies.features import StairTqcPolicy
from policies.rollout import run_episode

env = gym.make("stair_env/StairClimb-v0", max_episode_steps=60)
models = {
    "tqc": TQC(StairTqcPolicy, env, buffer_size=1000, learning_starts=20, seed=0),
    "ppo_lstm": RecurrentPPO("MultiInputLstmPolicy", env, n_steps=32, batch_size=32, seed=0),
}
with tempfile.TemporaryDirectory() as folder:
    for name, model in models.items():
        model.learn(64)
        model.save(Path(folder) / name)
        policy = pretrained.load(Path(folder) / f"{name}.zip", env)
        assert policy.algorithm == name
        print(f"{name}: {run_episode(env, policy, seed=0).control_steps} control steps")
env.close()
