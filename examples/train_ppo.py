"""Train PPO on the oracle's stairs with nothing but Stable-Baselines3, then count how many flights it climbs.

python examples/train_ppo.py --timesteps 300000 --output runs/example
"""

import argparse
from pathlib import Path

import gymnasium as gym
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

import stair_env  # noqa: F401  (registers the environment ids)
from policies.features import StairActorCriticPolicy
from policies.pretrained import load
from policies.rollout import run_episode

ENV_ID = "stair_env:stair_env/StairClimb-v0"  # the part before the colon is imported first, in worker processes too


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--timesteps", type=int, default=300_000)
    parser.add_argument("--num-envs", type=int, default=8)
    parser.add_argument("--output", type=Path, default=Path("runs/example"))
    args = parser.parse_args()

    stairs = {"direction": "up", "riser_height": [0.03, 0.12], "tread_depth": [0.26, 0.34]}
    venv = make_vec_env(ENV_ID, args.num_envs, seed=0, env_kwargs={**stairs, "curriculum": True})
    venv = VecNormalize(venv, norm_obs_keys=["proprio"])  # the stair block has a fixed scale of its own
    model = PPO(
        StairActorCriticPolicy,
        venv,
        n_steps=512,
        batch_size=512 if args.num_envs == 1 else 1024,
        n_epochs=8,
        target_kl=0.03,
        policy_kwargs={"net_arch": [256, 128], "log_std_init": -2.8},  # more noise, and the gait falls before it learns
        device="cpu",
        verbose=1,
    )
    model.learn(args.timesteps)
    args.output.mkdir(parents=True, exist_ok=True)
    model.save(args.output / "model.zip")
    venv.save(str(args.output / "vecnormalize.pkl"))
    venv.close()

    env = gym.make(ENV_ID, **stairs)
    policy = load(args.output, env)
    print(f"climbed {sum(run_episode(env, policy, seed).success for seed in range(10))} of 10 flights")


if __name__ == "__main__":
    main()
