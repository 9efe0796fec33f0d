import gymnasium as gym
import numpy as np
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

PLAIN, PERCEIVED = "stair_env/StairClimb-v0", "stair_env/StairClimbPerception-v0"


def test_spaces_are_exactly_those_of_the_oracle():
    plain, perceived = gym.make(PLAIN), gym.make(PERCEIVED)
    assert perceived.observation_space == plain.observation_space
    assert perceived.action_space == plain.action_space
    plain.close()
    perceived.close()


def test_checkers_are_clean():
    env = gym.make(PERCEIVED, disable_env_checker=True)
    check_env(env, skip_render_check=True)
    check_env_for_sb3(env, skip_render_check=True)


def test_the_robot_climbs_what_it_sees():
    """The real chain: frames, corruption, network, geometry, tracker, gait; nobody tells the robot the truth."""
    env = gym.make(PERCEIVED, riser_height=0.10, tread_depth=0.3, num_steps=3)
    climbed, errors = 0, []
    for seed in range(2):
        observation, info = env.reset(seed=seed)
        for _ in range(420):
            observation, _, terminated, _, info = env.step(np.zeros(16))
            truth, block = info["truth"], observation["stair"]
            if truth["valid"] and block[0] and truth["edge_distance"] < 1.0:
                errors.append([block[2] - truth["step_width"], block[3] - truth["step_height"]])
            if terminated:
                break
        climbed += info["is_success"]
    env.close()
    assert climbed >= 1
    assert np.median(np.abs(errors), axis=0).max() < 0.012


def test_same_seed_same_rollout():
    def rollout():
        env = gym.make(PERCEIVED)
        observation, _ = env.reset(seed=4)
        blocks = [observation["stair"]]
        for _ in range(20):
            observation, *_ = env.step(np.zeros(16))
            blocks.append(observation["stair"])
        env.close()
        return np.array(blocks)

    assert np.array_equal(rollout(), rollout())


def test_sb3_takes_it_as_it_is():
    env = gym.make(PERCEIVED)
    model = PPO("MultiInputPolicy", env, n_steps=8, batch_size=8, n_epochs=1)
    model.learn(8)
    env.close()
