"""Long runs over random staircases. STAIR_ENV_SOAK scales them: 1 is a million steps and ten thousand resets.

STAIR_ENV_SOAK_SEED draws other environments, so that a long run can be made of several short ones.
"""

import os

import numpy as np
import psutil
import pytest

from stair_env.env import StairClimbEnv
from stair_env.robots import ROBOTS

SCALE = float(os.environ.get("STAIR_ENV_SOAK", "0.005"))
SEED = int(os.environ.get("STAIR_ENV_SOAK_SEED", "0"))
ROBOT_SHARES = {"aliengo": 0.45, "a1": 0.45, "laikago": 0.05, "mini_cheetah": 0.05}  # resets of the latter two are slow
STEPS, RESETS = max(round(1_000_000 * SCALE), 500), max(round(10_000 * SCALE), 20)
WARM_UP_RESETS = 20  # until Bullet's and Python's pools have their size
GROWTH_LIMIT_MB = 20.0
EPISODE_STEPS = 200


def resident_mb():
    return psutil.Process().memory_info().rss / 1e6


def random_env(rng):
    return StairClimbEnv(
        robot=str(rng.choice(list(ROBOT_SHARES), p=list(ROBOT_SHARES.values()))),
        direction="both",
        riser_height=(0.05, 0.20),
        tread_depth=(0.22, 0.40),
        num_steps=(2, 12),
        actuation=str(rng.choice(["gait", "joint"])),
        stair_source=str(rng.choice(["oracle", "noisy", "blind", "shuffled"])),
        randomization=True,
        spawn="anywhere",
        uneven=0.01,
    )


@pytest.mark.slow
def test_random_actions_never_break_it():
    assert set(ROBOT_SHARES) == set(ROBOTS)
    rng = np.random.default_rng(SEED)
    taken = 0
    while taken < STEPS:
        env = random_env(rng)
        env.action_space.seed(int(rng.integers(2**31)))
        try:
            env.reset(seed=int(rng.integers(2**31)))
            for _ in range(EPISODE_STEPS):
                observation, reward, terminated, _, info = env.step(env.action_space.sample())
                taken += 1
                assert env.observation_space.contains(observation)
                assert np.isfinite(reward) and np.isfinite(list(info["reward_terms"].values())).all()
                if terminated:
                    env.reset()
        finally:
            env.close()


@pytest.mark.slow
def test_resets_do_not_leak():
    env = StairClimbEnv(direction="both", randomization=True, spawn="anywhere")
    try:
        env.reset(seed=0)
        for _ in range(WARM_UP_RESETS):
            env.reset()
        before = resident_mb()
        for _ in range(RESETS):
            env.reset()
            env.step(env.action_space.sample())
        assert resident_mb() - before <= GROWTH_LIMIT_MB
    finally:
        env.close()
