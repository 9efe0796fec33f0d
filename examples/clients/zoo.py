"""rl_zoo3: PPO with a curriculum, judged on the real task.

That takes `callback: policies.zoo.FullHeightEvaluation`, as our files of hyperparameters have it: without it the
evaluation, which inherits `curriculum`, would judge on the first and lowest riser.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import gymnasium as gym

import stair_env  # noqa: F401
from policies import hyperparams, pretrained
from policies.rollout import run_episode

ENV_ID = "stair_env/StairClimb-v0"
FILE = Path(hyperparams.__file__).with_name("ppo.yml")
SMALL = ["-n", "256", "--eval-freq", "128", "--eval-episodes", "1"]
SMALL += ["-params", "n_envs:1", "n_steps:128", "batch_size:64"]

with tempfile.TemporaryDirectory() as folder:
    train = [sys.executable, "-m", "rl_zoo3.train", "--algo", "ppo", "--env", ENV_ID, "--gym-packages", "stair_env"]
    train += ["-conf", str(FILE), "-f", folder, *SMALL, "--env-kwargs", "curriculum:True", "direction:'both'"]
    subprocess.run(train, check=True)
    run = next(Path(folder, "ppo").glob("*_1"))
    env = gym.make(ENV_ID, max_episode_steps=100)
    episode = run_episode(env, pretrained.load(run, env), seed=0)
    env.close()
print(f"zoo: {episode.control_steps} control steps, {episode.termination}")
