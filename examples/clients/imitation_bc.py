"""imitation: clone the shipped policy from its own flights, and save what came out as any policy of SB3."""

import tempfile
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from imitation.algorithms import bc
from imitation.data.types import DictObs, TrajectoryWithRew
from stable_baselines3 import PPO

import stair_env  # noqa: F401
from policies import pretrained
from policies.features import StairActorCriticPolicy
from policies.rollout import run_episode

env = gym.make("stair_env/StairClimb-v0", max_episode_steps=80)
teacher = pretrained.load("aliengo", env)


def fly(seed: int) -> TrajectoryWithRew:
    observation, _ = env.reset(seed=seed)
    seen: list[Any] = [observation]
    actions, rewards, ended = [], [], False
    while not ended:
        action, _ = teacher.predict(observation)
        observation, reward, terminated, truncated, _ = env.step(action)
        seen.append(observation)
        actions.append(action)
        rewards.append(reward)
        ended = terminated or truncated
    return TrajectoryWithRew(DictObs.from_obs_list(seen), np.array(actions), None, True, np.array(rewards, float))


flights = [fly(seed) for seed in range(3)]
student = PPO(StairActorCriticPolicy, env, n_steps=64, seed=0, device="cpu")
trainer = bc.BC(
    observation_space=env.observation_space,
    action_space=env.action_space,
    rng=np.random.default_rng(0),
    policy=student.policy,
    demonstrations=flights,
    batch_size=32,
    device="cpu",
)


def error() -> float:
    seen, wanted = flights[0].obs[:-1].unwrap(), flights[0].acts
    return float(np.abs(student.predict(seen, deterministic=True)[0] - wanted).mean())


before = error()
trainer.train(n_epochs=4, progress_bar=False, log_interval=10**6)
assert error() < before, "nothing was learned"
with tempfile.TemporaryDirectory() as folder:
    student.save(Path(folder) / "model")
    episode = run_episode(env, pretrained.load(Path(folder) / "model.zip", env), seed=9)
env.close()
print(f"imitation: actions off by {before:.3f}, then {error():.3f}; the copy walked {episode.control_steps} steps")
