"""What Gymnasium's suite asks of vector environments, asked of our ids: under its own classes and under ours alike."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers import vector as wrappers

from stair_env import ENV_IDS

PLAIN, RGBD, PERCEPTION = ENV_IDS
OURS, MODES = "vector_entry_point", ("sync", "async", "vector_entry_point")
SMALL_CAMERA = {"width": 64, "colour_error": "ideal", "depth_error": "ideal"}
ID_ARGUMENTS: dict[str, dict[str, Any]] = {PLAIN: {}, RGBD: {"camera": SMALL_CAMERA}, PERCEPTION: {}}
NUM_ENVS, LIMIT = 2, 4
Maker = Callable[..., VectorEnv]


@pytest.fixture()
def make() -> Iterator[Maker]:
    """`gym.make_vec` with few environments and short episodes; closes what it made."""
    made: list[VectorEnv] = []

    def maker(env_id: str = PLAIN, mode: str = OURS, autoreset: str = "NextStep", **kwargs: Any) -> VectorEnv:
        arguments = {"max_episode_steps": LIMIT, **ID_ARGUMENTS[env_id], **kwargs}
        if mode == OURS:
            arguments |= {"autoreset_mode": autoreset, "workers": 1, "caller_steps": True}
        else:
            arguments["vector_kwargs"] = {"autoreset_mode": AutoresetMode(autoreset)}
        made.append(gym.make_vec(env_id, num_envs=NUM_ENVS, vectorization_mode=mode, **arguments))
        return made[-1]

    yield maker
    for env in made:
        env.close()


def still(env: VectorEnv) -> np.ndarray:
    return np.zeros(env.action_space.shape, np.float32)


def leaves(tree: Any, path: str = "") -> dict[str, Any]:
    """Arrays of nested dicts by path; arrays of objects are taken apart."""
    if isinstance(tree, dict):
        return {k: v for key, value in tree.items() for k, v in leaves(value, f"{path}/{key}").items()}
    if isinstance(tree, (tuple, list)) or (isinstance(tree, np.ndarray) and tree.dtype == object):
        return {k: v for i, value in enumerate(tree) for k, v in leaves(value, f"{path}/{i}").items()}
    return {path: tree}


def assert_equal_trees(a: Any, b: Any) -> None:
    a, b = leaves(a), leaves(b)
    assert a.keys() == b.keys()
    for path, value in a.items():
        np.testing.assert_array_equal(value, b[path], err_msg=path)


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_what_comes_back_has_the_declared_shapes_and_types(make: Maker, env_id: str) -> None:
    env = make(env_id)
    assert env.num_envs == NUM_ENVS and env.observation_space.shape is None
    assert env.action_space.shape == (NUM_ENVS, *env.single_action_space.shape)
    observation, infos = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    for _ in range(LIMIT + 2):  # over an episode's end
        observation, reward, terminated, truncated, infos = env.step(still(env))
        assert env.observation_space.contains(observation)
        for values, dtype in ((reward, np.float64), (terminated, np.bool_), (truncated, np.bool_)):
            assert isinstance(values, np.ndarray) and values.shape == (NUM_ENVS,) and values.dtype == dtype
        masks = {key: value for key, value in infos.items() if key.startswith("_")}
        assert {key[1:] for key in masks} == set(infos) - set(masks)
        assert all(mask.shape == (NUM_ENVS,) and mask.dtype == np.bool_ for mask in masks.values())


@pytest.mark.parametrize("autoreset", ["NextStep", "SameStep"])
@pytest.mark.parametrize("env_id", [PLAIN, RGBD])
def test_three_ways_to_make_a_vector_give_the_same(make: Maker, env_id: str, autoreset: str) -> None:
    vectors = [make(env_id, mode, autoreset) for mode in (MODES if env_id == PLAIN else ("sync", OURS))]
    first = vectors[0]
    for env in vectors[1:]:
        assert env.observation_space == first.observation_space and env.action_space == first.action_space
        assert env.metadata["autoreset_mode"] is AutoresetMode(autoreset)
    rng = np.random.default_rng(0)
    results = [env.reset(seed=[5, 9]) for env in vectors]
    for _ in range(LIMIT + 3):
        for result in results[1:]:
            assert_equal_trees(result, results[0])
        actions = rng.uniform(-0.2, 0.2, first.action_space.shape).astype(np.float32)
        results = [env.step(actions) for env in vectors]


@pytest.mark.parametrize("mode", MODES)
def test_seeds_repeat_an_episode_and_none_goes_on(make: Maker, mode: str) -> None:
    env = make(mode=mode)
    one, two = env.reset(seed=3)[0], env.reset(seed=[3, 4])[0]
    assert_equal_trees(one, two)
    assert not np.array_equal(one["proprio"][0], one["proprio"][1])  # another environment, another seed
    later = env.reset()[0]
    assert not np.array_equal(one["proprio"], later["proprio"])
    env.reset(seed=3)
    assert_equal_trees(env.reset()[0], later)


@pytest.mark.parametrize("mode", MODES)
def test_same_step_hands_out_the_end_of_an_episode(make: Maker, mode: str) -> None:
    env = make(mode=mode, autoreset="SameStep")
    env.reset(seed=1)
    for _ in range(LIMIT):
        observation, _, _, truncated, infos = env.step(still(env))
    assert truncated.all() and infos["_final_obs"].all() and infos["_final_info"].all()
    assert infos["final_info"]["steps_climbed"].shape == (NUM_ENVS,)
    for index in range(NUM_ENVS):
        final = infos["final_obs"][index]
        assert env.single_observation_space.contains(final)
        assert not np.array_equal(final["proprio"], observation["proprio"][index])


@pytest.mark.parametrize("mode", MODES)
def test_disabled_autoreset_resets_whom_the_mask_chooses(make: Maker, mode: str) -> None:
    env = make(mode=mode, autoreset="Disabled")
    env.reset(seed=1)
    before = [env.step(still(env)) for _ in range(2)][-1][0]
    after, infos = env.reset(options={"reset_mask": np.array([True, False])})
    assert not np.array_equal(after["proprio"][0], before["proprio"][0])
    np.testing.assert_array_equal(after["proprio"][1], before["proprio"][1])
    assert infos["_truth"].tolist() == [True, False]


@pytest.mark.parametrize("mode", MODES)
def test_attributes_and_methods_of_the_environments(make: Maker, mode: str) -> None:
    env: Any = make(mode=mode)
    env.reset(seed=0)
    env.set_attr("nickname", ["a", "b"])
    assert env.get_attr("nickname") == ("a", "b")
    env.set_attr("nickname", "c")
    assert env.call("nickname") == ("c", "c")
    assert len(env.call("get_wrapper_attr", "robot")) == NUM_ENVS
    with pytest.raises(ValueError):
        env.set_attr("nickname", ["a"] * (NUM_ENVS + 1))


@pytest.mark.parametrize("mode", MODES)
def test_every_environment_renders(make: Maker, mode: str) -> None:
    env = make(mode=mode, render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render_mode == "rgb_array"
    frames = env.render()
    assert len(frames) == NUM_ENVS and all(frame.dtype == np.uint8 and frame.ndim == 3 for frame in frames)


@pytest.mark.parametrize("mode", MODES)
def test_the_spec_makes_the_same_again(make: Maker, mode: str) -> None:
    env = make(mode=mode, riser_height=0.1)
    assert env.spec is not None and env.spec.id == PLAIN and env.spec.kwargs["riser_height"] == 0.1
    again = gym.make_vec(pickle.loads(pickle.dumps(env.spec)))
    try:
        assert again.num_envs == NUM_ENVS and again.spec == env.spec
        assert_equal_trees(again.reset(seed=2)[0], env.reset(seed=2)[0])
    finally:
        again.close()


def test_actions_for_more_environments_than_there_are_are_refused(make: Maker) -> None:
    env = make()
    env.reset(seed=0)
    with pytest.raises(ValueError):
        env.step(np.zeros((NUM_ENVS + 1, *env.single_action_space.shape), np.float32))


@pytest.mark.parametrize("mode", MODES)
def test_closing_twice_is_fine_and_closed_is_told(make: Maker, mode: str) -> None:
    env = make(mode=mode)
    env.reset(seed=0)
    env.close()
    env.close()
    assert env.closed


@pytest.mark.parametrize(
    "wrap",
    [
        wrappers.RecordEpisodeStatistics,
        wrappers.DictInfoToList,
        wrappers.FlattenObservation,
        wrappers.NormalizeReward,
        lambda env: wrappers.RescaleAction(env, -2.0, 2.0),
        lambda env: wrappers.ClipReward(env, -1.0, 1.0),
    ],
)
def test_gymnasiums_wrappers_do_to_ours_what_they_do_to_its_own(make: Maker, wrap: Callable[[Any], Any]) -> None:
    ours, theirs = wrap(make()), wrap(make(mode="sync"))
    assert ours.observation_space == theirs.observation_space and ours.action_space == theirs.action_space
    assert_equal_trees(ours.reset(seed=7), theirs.reset(seed=7))
    for _ in range(LIMIT + 2):
        a, b = ours.step(still(ours)), theirs.step(still(ours))
        clocks = {"/4/episode/t", "/4/_episode/t"}
        a, b = ({path: value for path, value in leaves(step).items() if path not in clocks} for step in (a, b))
        assert_equal_trees(a, b)
