import importlib.util
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import stair_env
from perception.wrapper import PerceptionWrapper
from stair_env.common.constants import PHYSICS_ENGINES
from stair_env.common.importing.extras import MissingExtraError
from stair_env.common.validation import SpecError
from stair_env.env import StairClimbEnv
from stair_env.physics import engines
from stair_env.physics.engines import check_engine, check_renderer, open_engine
from stair_env.physics.simulation import Simulation
from stair_env.robots import ROBOTS

needs_mujoco = pytest.mark.skipif(
    importlib.util.find_spec("mujoco") is None, reason="MuJoCo is not installed: pip install 'stair-env[mujoco]'"
)
SMALL = {"width": 160}  # a camera that draws quickly
CAMERAS = {"stair_env/StairClimb-v0": {}}  # arguments of the ids that have no camera


@pytest.mark.parametrize("env_id", stair_env.ENV_IDS)
def test_a_wrong_engine_names_the_choices(env_id):
    with pytest.raises(SpecError, match=r"engine='ode'.*'bullet'.*'mujoco'"):
        gym.make(env_id, engine="ode")


@pytest.mark.parametrize("env_id", stair_env.ENV_IDS)
def test_a_missing_engine_names_the_extra(env_id, monkeypatch):
    monkeypatch.setattr(engines.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"engine='mujoco'.*pip install 'stair-env\[mujoco\]'"):
        gym.make(env_id, engine="mujoco")


def test_bullet_needs_no_mujoco_and_loads_none():
    code = (
        "import sys, gymnasium as gym, stair_env\n"
        "env = gym.make('stair_env/StairClimb-v0'); env.reset(seed=0)\n"
        "assert env.unwrapped.engine == 'bullet' and 'mujoco' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=600)


def test_bullets_renderers_are_refused_where_bullet_does_not_work():
    check_renderer("bullet", "tiny")
    check_renderer("mujoco", "raycast")
    with pytest.raises(SpecError, match=r"renderer='tiny'.*engine='mujoco'.*'raycast'"):
        check_renderer("mujoco", "tiny")


def test_the_default_is_bullet():
    sim = open_engine(PHYSICS_ENGINES[0], ROBOTS["a1"], visible=False)
    assert isinstance(sim, Simulation) and sim.client is not None
    sim.close()
    assert check_engine("bullet") == StairClimbEnv().engine == "bullet"


@needs_mujoco
@pytest.mark.filterwarnings("error::UserWarning")
@pytest.mark.parametrize("env_id", stair_env.ENV_IDS)
def test_checkers_are_clean_in_mujoco(env_id):
    env = gym.make(env_id, engine="mujoco", **({} if env_id in CAMERAS else {"camera": SMALL}))
    check_env(env.unwrapped)
    env.close()


@needs_mujoco
def test_the_perceived_form_passes_its_check_too():
    """`unwrapped` of the perception id is the environment below the network: here the whole is checked."""
    env = gym.make("stair_env/StairClimbPerception-v0", engine="mujoco", camera=SMALL, disable_env_checker=True)
    while not isinstance(env, PerceptionWrapper):
        env = env.env
    check_env(env, skip_render_check=True)
    env.close()


@needs_mujoco
@pytest.mark.parametrize("env_id", stair_env.ENV_IDS)
def test_spaces_do_not_depend_on_the_engine(env_id):
    camera = {} if env_id in CAMERAS else {"camera": SMALL}
    envs = [gym.make(env_id, engine=engine, **camera) for engine in PHYSICS_ENGINES]
    assert envs[0].observation_space == envs[1].observation_space
    assert envs[0].action_space == envs[1].action_space
    for env in envs:
        env.close()


@needs_mujoco
def test_pictures_show_the_robot_and_their_depth():
    pictures = []
    for mode in ("rgb_array", "depth_array"):
        env = gym.make("stair_env/StairClimb-v0", engine="mujoco", render_mode=mode)
        env.reset(seed=0)
        env.step(np.zeros(16, np.float32))
        pictures.append(env.render())
        env.close()
    colour, depth = pictures
    assert colour.shape == (480, 640, 3) and colour.dtype == np.uint8 and colour.std() > 10
    assert depth.shape == (480, 640) and depth.dtype == np.float32
    assert 1.0 < depth[200:280, 280:360].min() < 2.5  # the trunk


@needs_mujoco
def test_a_camera_that_draws_with_bullet_is_refused():
    with pytest.raises(SpecError, match="renderer='tiny'"):
        gym.make("stair_env/StairClimbRGBD-v0", engine="mujoco", camera={"renderer": "tiny"})


@needs_mujoco
def test_a_camera_sees_the_same_stairs_in_both_engines():
    """The pose of the standing robot differs by millimetres, and so do the frames."""
    frames = []
    for engine in PHYSICS_ENGINES:
        env = gym.make("stair_env/StairClimbRGBD-v0", engine=engine, camera={**SMALL, "depth_error": "ideal"})
        frames.append(env.reset(seed=4)[0]["depth"])
        env.close()
    both = (frames[0] > 0) & (frames[1] > 0)
    assert both.mean() > 0.5 and np.median(np.abs(frames[0] - frames[1])[both]) < 0.02
