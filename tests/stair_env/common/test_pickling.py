import pickle

import gymnasium as gym
import numpy as np
import pytest

from stair_env.common.pickling import PicklesByArguments
from stair_env.onboard.proprioception import AttitudeFilter

CAMERA = {"camera": {"width": 160}}


class Box(PicklesByArguments):
    def __init__(self, width, *, height=1.0):
        self.area, self.lock = width * height, lambda: None


class Cube(Box):
    def __init__(self, width, **kwargs):
        super().__init__(width, height=width, **kwargs)


@pytest.mark.parametrize(("made", "area"), [(lambda: Box(2.0, height=3.0), 6.0), (lambda: Cube(2.0), 4.0)])
def test_comes_back_as_if_just_made(made, area):
    twin = pickle.loads(pickle.dumps(made()))
    assert type(twin) is type(made()) and twin.area == area


@pytest.mark.parametrize(
    ("name", "kwargs"),
    [("StairClimb", {"direction": "both"}), ("StairClimbRGBD", CAMERA), ("StairClimbPerception", CAMERA)],
)
def test_environments_pickle_also_after_use(name, kwargs):
    env = gym.make(f"stair_env/{name}-v0", riser_height=0.11, privileged=True, **kwargs)
    first, _ = env.reset(seed=3)
    env.step(np.zeros(16, np.float32))
    twin = pickle.loads(pickle.dumps(env))
    again, _ = twin.reset(seed=3)
    assert twin.observation_space == env.observation_space and again.keys() == first.keys()
    for key in first:
        np.testing.assert_array_equal(again[key], first[key])
    env.close(), twin.close()


def test_a_filter_comes_back_unused():
    attitude = AttitudeFilter(240.0, gain=0.3)
    attitude.reset(np.array([0.0, 3.0, 9.0]))
    assert pickle.loads(pickle.dumps(attitude)).up == pytest.approx([0.0, 0.0, 1.0])
