import json
import pickle
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

import stair_env
from stair_env.env import StairClimbEnv
from stair_env.observation import PROPRIO_SIZE, StairBlock

PLAIN = "stair_env/StairClimb-v0"
ROLLOUT = """
import gymnasium as gym, numpy as np, stair_env, hashlib
env = gym.make("{env_id}", direction="both", randomization=True, stair_source="noisy", riser_height=0.08)
digest = hashlib.sha256()
for episode in range(2):
    observation, info = env.reset(seed=7 if episode == 0 else None)
    rng = np.random.default_rng(1)
    for _ in range(60):
        observation, reward, *_ = env.step(rng.uniform(-0.2, 0.2, 16).astype(np.float32))
        digest.update(observation["proprio"].tobytes() + observation["stair"].tobytes() + np.float64(reward).tobytes())
print("digest", digest.hexdigest())
"""


def climb(env, seed, options=None, steps=1200):
    _, info = env.reset(seed=seed, options=options)
    for _ in range(steps):
        _, _, terminated, truncated, info = env.step(np.zeros(env.action_space.shape))
        if terminated or truncated:
            break
    return info


@pytest.mark.filterwarnings("error::UserWarning")
def test_checkers_are_clean():
    check_env(gym.make(PLAIN).unwrapped)
    check_env_for_sb3(gym.make(PLAIN).unwrapped)


@pytest.mark.parametrize("robot", ["aliengo", "a1"])
def test_the_bare_gait_climbs_low_stairs(robot):
    env = gym.make(PLAIN, robot=robot, riser_height=0.06, num_steps=4)
    results = [climb(env, seed) for seed in range(3)]
    env.close()
    assert sum(result["is_success"] for result in results) >= 2
    for result in results:
        if result["is_success"]:
            assert result["steps_climbed"] == 4 and result["termination"] == "success"


def test_blind_and_shuffled_do_not_climb_what_the_oracle_climbs():
    """The control that makes the comparison honest: without the right stair block the same gait fails."""
    successes = {}
    for source in ("oracle", "blind", "shuffled"):
        env = gym.make(PLAIN, stair_source=source, riser_height=0.15, num_steps=5)
        successes[source] = sum(climb(env, seed, steps=420)["is_success"] for seed in range(4))
        env.close()
    assert successes["oracle"] >= 3 > max(successes["blind"], successes["shuffled"]) + 1


def test_walks_down_a_low_flight():
    env = gym.make(PLAIN, direction="down", riser_height=0.06, num_steps=3)
    results = [climb(env, seed) for seed in range(3)]
    env.close()
    assert sum(result["is_success"] for result in results) >= 2


def digest_in_fresh_process():
    code = ROLLOUT.format(env_id=PLAIN)
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    return next(line for line in out.splitlines() if line.startswith("digest"))


def test_same_seed_same_rollout_in_a_fresh_process_too():
    assert digest_in_fresh_process() == digest_in_fresh_process()


def test_an_episode_does_not_depend_on_those_before_it():
    env = StairClimbEnv(direction="both", randomization=True)
    first = climb(env, 11, steps=40)["truth"]
    for seed in range(3):
        climb(env, seed, steps=25)
    assert data_equivalence(climb(env, 11, steps=40)["truth"], first)
    env.close()


def test_rewards_are_the_sum_of_their_named_terms():
    env = StairClimbEnv()
    env.reset(seed=0)
    for _ in range(20):
        _, reward, _, _, info = env.step(env.action_space.sample())
        assert reward == pytest.approx(sum(info["reward_terms"].values()))
    env.close()


def test_the_gait_reads_the_block_it_is_given_and_nothing_else():
    def feet(block):
        env = StairClimbEnv(stair_source="external", riser_height=0.15)
        env.reset(seed=5)
        for _ in range(30):
            env.provide_stair(block)
            env.step(np.zeros(16))
        heights = env.gait.foothold_heights
        env.close()
        return heights

    seen = StairBlock(1.0, 1.0, 0.3, 0.15, 0.02, 0.0, 0.0, 1.0)
    assert np.ptp(feet(seen)) > 0.1  # a step is believed under the front feet
    assert np.ptp(feet(StairBlock())) < 1e-6


def test_given_stairs_are_climbed():
    env = StairClimbEnv()
    spec = {"direction": "down", "riser_height": 0.11, "tread_depth": 0.33, "num_steps": 3}
    _, info = env.reset(seed=0, options={"stairs": spec, "x": -0.7, "y": 0.05, "yaw": 0.1})
    assert info["truth"]["riser_height"] == 0.11 and info["truth"]["num_steps"] == 3
    assert info["truth"]["yaw"] == pytest.approx(0.1, abs=0.02)
    with pytest.raises(ValueError, match="stairs"):
        env.reset(options={"stair": spec})
    env.close()


def test_joint_actuation_and_curriculum():
    env = StairClimbEnv(actuation="joint", curriculum={"start": 0.02, "window": 1, "levels": 3, "review": 0.0})
    observation, info = env.reset(seed=0)
    assert env.action_space.shape == (12,) and observation["proprio"].shape == (PROPRIO_SIZE - 4,)
    assert info["curriculum_level"] == 0 and info["truth"]["riser_height"] == pytest.approx(0.02)
    for _ in range(20):
        observation, *_ = env.step(np.zeros(12))
    assert env.observation_space.contains(observation)
    env.close()


def test_an_episode_that_runs_out_of_time_counts_against_the_level():
    env = StairClimbEnv(curriculum={"start": 0.02, "window": 1, "levels": 3})
    env.curriculum.level = 2
    env.reset(seed=0)
    env.reset(seed=1)  # nothing happened yet
    assert env.curriculum.level == 2
    env.step(np.zeros(16))
    env.reset(seed=2)
    assert env.curriculum.level == 1
    env.close()


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("robot", "spot"),
        ("riser_height", -1),
        ("tread_depth", [0.3, 0.2]),
        ("num_steps", 0),
        ("direction", "left"),
        ("lighting", "dusk"),
        ("actuation", "wheels"),
        ("stair_source", "psychic"),
        ("render_mode", "ascii"),
        ("spawn", "roof"),
        ("curriculum", 3),
        ("randomization", {"gravity": 1}),
        ("reward_weights", {"joy": 1.0}),
        ("reward_weights", {"fall": float("nan")}),
    ],
)
def test_wrong_arguments_are_named(argument, value):
    with pytest.raises(ValueError, match=argument):
        StairClimbEnv(**{argument: value})


def test_misuse_is_told():
    env = StairClimbEnv()
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros(16))
    env.reset(seed=0)
    with pytest.raises(ValueError, match="shape"):
        env.step(np.zeros(3))
    with pytest.raises(RuntimeError, match="external"):
        env.provide_stair(StairBlock())
    with pytest.raises(ValueError, match="8 finite"):
        StairBlock.from_array(np.full(8, np.nan))
    env.close()
    env.close()


def test_pictures():
    for mode, shape, dtype in (("rgb_array", (480, 640, 3), np.uint8), ("depth_array", (480, 640), np.float32)):
        env = gym.make(PLAIN, render_mode=mode)
        env.reset(seed=0)
        picture = env.render()
        env.close()
        assert picture.shape == shape and picture.dtype == dtype
        assert picture.std() > 0.1  # not blank


def test_specs_are_json_and_registration_is_idempotent():
    stair_env.register_envs()
    env = gym.make(PLAIN, riser_height=[0.1, 0.12], randomization={"push_speed": 0.0})
    spec = gym.envs.registration.EnvSpec.from_json(env.spec.to_json())
    twin = gym.make(spec)
    assert twin.spec.kwargs == json.loads(json.dumps(env.spec.kwargs))
    assert pickle.loads(pickle.dumps(env.spec)) == env.spec
    assert gym.make("stair_env:" + PLAIN).spec.id == PLAIN
    env.close()
    twin.close()


def shape_of(info):
    """Keys, types and shapes of everything in an info."""
    if isinstance(info, dict):
        return {key: shape_of(value) for key, value in info.items()}
    return (type(info), info.shape, info.dtype) if isinstance(info, np.ndarray) else type(info)


@pytest.mark.parametrize("env_id", stair_env.ENV_IDS)
def test_infos_have_the_same_keys_and_types_at_reset_and_at_every_step(env_id):
    """What stacks infos (replay buffers, recorders, vectors) needs a column to stay what it began as."""
    env = gym.make(env_id, curriculum=True, max_episode_steps=30, camera={"width": 64})
    _, info = env.reset(seed=0)
    first = shape_of(info)
    assert info["termination"] == "" and set(info["reward_terms"].values()) == {0.0}
    assert not [value for part in (info, info["truth"]) for value in part.values() if isinstance(value, (list, tuple))]
    ended = False
    while not ended:
        _, _, terminated, truncated, info = env.step(env.action_space.low)
        ended = terminated or truncated
        assert shape_of(info) == first
    assert shape_of(env.reset()[1]) == first
    env.close()


@pytest.fixture(scope="module")
def standing():
    env = gym.make(PLAIN, disable_env_checker=True, max_episode_steps=10_000)
    env.reset(seed=0)
    yield env
    env.close()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 15), st.sampled_from([np.nan, np.inf, -np.inf]))
def test_an_action_that_is_no_number_is_refused_and_harms_nothing(standing, index, value):
    action = np.zeros(16, np.float32)
    action[index] = value
    with pytest.raises(ValueError, match=rf"action holds {value} at index {index}"):
        standing.step(action)
    observation, reward, *_ = standing.step(np.zeros(16, np.float32))
    assert np.isfinite(reward) and np.isfinite(observation["proprio"]).all()


@pytest.mark.parametrize("action", [None, "left", [[0.0] * 16], {"speed": 1.0}, [0.0] * 15 + ["x"]])
def test_an_action_of_another_kind_is_refused(standing, action):
    with pytest.raises(ValueError, match="action"):
        standing.step(action)


@pytest.mark.parametrize("env_id", stair_env.ENV_IDS)
@pytest.mark.parametrize("camera", [{"nonsense": 1}, {"width": -5}, "fisheye", 3])
def test_wrong_camera_options_are_told_by_every_id(env_id, camera):
    with pytest.raises(ValueError, match=r"camera|width"):
        gym.make(env_id, camera=camera)


@pytest.mark.parametrize("env_id", stair_env.ENV_IDS)
@pytest.mark.parametrize("kind", ["rgb_array", "depth_array"])
def test_pictures_are_collected_on_every_id(env_id, kind):
    env = gym.make(env_id, render_mode=f"{kind}_list", camera={"width": 64})
    env.reset(seed=0)
    env.step(np.zeros(16, np.float32))
    pictures = env.render()
    env.close()
    assert len(pictures) == 2 and pictures[0].shape[:2] == (480, 640)


@pytest.mark.parametrize("options", [{"x": np.nan}, {"y": "left"}, {"yaw": None}, {"stairs": 3}, {"stairs": {"a": 1}}])
def test_wrong_reset_options_are_named_and_leave_the_episode_alone(options):
    env = StairClimbEnv()
    env.reset(seed=1)
    before, stairs = env.np_random.bit_generator.state, env.stairs
    told = r"StairSpec|field" if "stairs" in options else f"option {next(iter(options))}"
    with pytest.raises(ValueError, match=told):
        env.reset(seed=2, options=options)
    assert env.np_random.bit_generator.state == before and env.stairs is stairs
    env.close()


@pytest.mark.skipif(sys.platform != "linux", reason="about X displays")
@pytest.mark.parametrize("display", [":77", "nowhere.invalid:0", "no display", ""])
def test_a_display_that_nobody_serves_is_a_warning(display, monkeypatch, caplog):
    monkeypatch.setenv("DISPLAY", display)
    env = gym.make(PLAIN, render_mode="human")
    env.reset(seed=0)
    env.step(np.zeros(16, np.float32))
    env.close()
    assert "without a window" in caplog.text


def test_nothing_is_printed_on_standard_output():
    """A program's standard output is the program's; PyBullet echoes its options there."""
    code = f"import gymnasium as gym, stair_env; e = gym.make('{PLAIN}'); e.reset(seed=0); e.close(); print('{{}}')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "{}\n"
