import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

from stair_env.env import StairClimbEnv
from stair_env.task.privileged import PRIVILEGED_SLICES, privileged_space

PLAIN = "stair_env/StairClimb-v0"


def field(observation, name):
    return observation["privileged"][PRIVILEGED_SLICES[name]]


def walk(env, seed, steps=30):
    observation, info = env.reset(seed=seed)
    for _ in range(steps):
        observation, _, _, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
    return observation, info


@pytest.mark.filterwarnings("error::UserWarning")
def test_checkers_are_clean():
    check_env(gym.make(PLAIN, privileged=True).unwrapped, skip_render_check=True)
    check_env_for_sb3(gym.make(PLAIN, privileged=True).unwrapped, skip_render_check=True)


def test_off_by_default_and_nothing_else_changes():
    with_it, without = StairClimbEnv(privileged=True, randomization=True), StairClimbEnv(randomization=True)
    assert set(without.observation_space) == {"proprio", "stair"}
    assert with_it.observation_space["privileged"] == privileged_space()
    (seen, _), (plain, _) = walk(with_it, 3), walk(without, 3)
    assert set(plain) == {"proprio", "stair"} and with_it.observation_space.contains(seen)
    for key in plain:
        np.testing.assert_array_equal(seen[key], plain[key])
    with_it.close()
    without.close()


def test_it_is_the_truth():
    env = StairClimbEnv(privileged=True, randomization=True, stair_source="blind", riser_height=0.12)
    observation, info = walk(env, 5, steps=60)
    assert not observation["stair"].any()
    stair = field(observation, "stair")
    assert stair[:4] == pytest.approx([1.0, 1.0, info["truth"]["step_width"], 0.12], abs=1e-6)
    speed = np.linalg.norm(info["truth"]["velocity"])
    assert np.linalg.norm(field(observation, "velocity")) == pytest.approx(speed, rel=1e-5)
    body = [float(field(observation, name)[0]) for name in ("friction", "payload_kg", "motor_strength")]
    assert body == pytest.approx(env.state.episode.body, abs=1e-6)
    draws = env.randomization
    assert all(low <= value <= high for value, (low, high) in zip(body, (draws.friction, draws.payload_kg, (0.9, 1.1))))
    env.close()


def test_standing_feet_carry_the_weight_and_touch_the_ground():
    env = StairClimbEnv(privileged=True, actuation="joint")
    observation, _ = walk(env, 0, steps=60)
    force = field(observation, "foot_force").reshape(4, 3)
    assert force[:, 2].sum() == pytest.approx(env.robot.mass * 9.81, rel=0.1)
    assert field(observation, "foot_clearance") == pytest.approx(np.zeros(4), abs=0.01)
    assert field(observation, "base_height")[0] == pytest.approx(env.robot.stand_height + 0.0265, abs=0.03)
    env.close()


def test_the_camera_environments_carry_it_too():
    from perception.wrapper import perceived_observation, perceived_space
    from stair_env.rgbd import StairClimbRgbdEnv

    env = StairClimbRgbdEnv(camera={"width": 160}, privileged=True)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    perceived = perceived_observation(observation, np.zeros(8, np.float32))
    assert set(perceived) == {"proprio", "stair", "privileged"}
    assert perceived_space(env.observation_space.spaces).contains(perceived)
    env.close()


def test_a_wrong_value_is_named():
    with pytest.raises(ValueError, match="privileged"):
        StairClimbEnv(privileged="yes")
