import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from stair_env.common.validation import SpecError
from stair_env.env import StairClimbEnv
from stair_env.rgbd import StairClimbRgbdEnv
from stair_env.task.observation_terms import ObservationTerm, read_observations

SPACE = gym.spaces.Box(-1.0, 1.0, (4,), np.float32)


def feet_x(state):
    return state.feet[:, 0] * 100.0


def test_own_parts_are_cast_and_clipped_into_their_space():
    env = StairClimbEnv(observations={"feet_x": ObservationTerm(feet_x, SPACE), "stair": None}, privileged=True)
    observation, _ = env.reset(seed=0)
    assert set(env.observation_space) == {"proprio", "feet_x", "privileged"}
    assert env.observation_space.contains(observation) and observation["feet_x"].tolist() == [-1.0] * 4
    env.close()


@pytest.mark.filterwarnings("error::UserWarning")
def test_the_checker_is_clean():
    env = gym.make("stair_env/StairClimb-v0", observations={"feet_x": ObservationTerm(feet_x, SPACE)})
    check_env(env.unwrapped, skip_render_check=True)


def test_camera_environments_take_them_too():
    env = StairClimbRgbdEnv(
        camera={"width": 160}, observations={"feet_x": ObservationTerm(feet_x, SPACE), "depth": None}
    )
    observation, _ = env.reset(seed=0)
    assert set(observation) == {"proprio", "imu", "rgb", "feet_x"} and env.observation_space.contains(observation)
    env.close()


@pytest.mark.parametrize(
    ("observations", "message"),
    [
        ({"depth": None}, "observations.*depth.*proprio"),
        ({"feet_x": feet_x}, "feet_x.*ObservationTerm"),
        ({"stair": ObservationTerm(feet_x, SPACE)}, "stair.*taken"),
        (3, "mapping"),
    ],
)
def test_wrong_observations_are_named(observations, message):
    with pytest.raises(SpecError, match=message):
        StairClimbEnv(observations=observations)


def test_wrong_terms_are_named(make_state):
    with pytest.raises(SpecError, match="fn=3"):
        ObservationTerm(3, SPACE)
    with pytest.raises(SpecError, match="Box"):
        ObservationTerm(feet_x, gym.spaces.Discrete(3))
    terms = read_observations({"feet": ObservationTerm(lambda state: state.feet, SPACE)}, False, {})
    with pytest.raises(SpecError, match="observations\\['feet'\\] returned"):
        terms.select({}, make_state())
