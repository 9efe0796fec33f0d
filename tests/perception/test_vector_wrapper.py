"""Many environments, one batch: the same answers as one by one."""

from __future__ import annotations

import functools
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from perception.estimator import StairEstimator
from perception.vector_wrapper import PerceptionVectorWrapper
from perception.wrapper import PerceptionWrapper
from stair_env.observation import PROPRIO_SLICES
from stair_env.rgbd import StairClimbRgbdEnv
from stair_env.vector import make_rgbd_vec

PERCEIVED = "stair_env/StairClimbPerception-v0"
OPTIONS: dict[str, Any] = {"camera": {"width": 160}, "num_steps": 3}


class RecordingDetector:
    """Sees two lines always, and notes how many frames came at once."""

    def __init__(self) -> None:
        self.batches: list[int] = []

    def detect(self, rgb: Any, depth_m: Any) -> tuple[np.ndarray, np.ndarray]:
        self.batches.append(len(rgb))
        cls, loc = np.zeros((len(rgb), 32, 16)), np.full((len(rgb), 32, 16, 8), 0.5)
        cls[:, [14, 20]] = 1.0
        loc[..., 0::4], loc[..., 2::4] = 0.0, 1.0
        return cls, loc


def make_vector(detector: RecordingDetector, count: int) -> PerceptionVectorWrapper:
    vector = SyncVectorEnv([lambda: StairClimbRgbdEnv(**OPTIONS)] * count)
    first: Any = vector.envs[0].unwrapped
    return PerceptionVectorWrapper(vector, first.robot, first.camera_intrinsics, StairEstimator(detector=detector))


def test_a_vector_of_two_is_two_single_environments() -> None:
    detector = RecordingDetector()
    vector = make_vector(detector, 2)
    singles = [
        PerceptionWrapper(StairClimbRgbdEnv(**OPTIONS), StairEstimator(detector=RecordingDetector())) for _ in range(2)
    ]
    observations, _ = vector.reset(seed=[3, 4])
    expected = [env.reset(seed=seed)[0] for env, seed in zip(singles, (3, 4))]
    actions = np.zeros((2, *singles[0].action_space.shape), np.float32)  # type: ignore[misc]
    for _ in range(9):
        for index, single in enumerate(expected):
            for key, value in single.items():
                assert np.array_equal(observations[key][index], value), key
        assert vector.observation_space.contains(observations)
        observations, *_, infos = vector.step(actions)
        expected = [env.step(actions[0])[0] for env in singles]
        assert infos["perceived"]["frame"].shape == (2,)
    assert max(detector.batches) == 2
    assert sum(batch > 0 for batch in detector.batches) < 9  # not at every step: frames come at 15 Hz
    for env in (vector, *singles):
        env.close()


def test_an_environment_that_starts_anew_forgets_its_staircase() -> None:
    vector = make_vector(RecordingDetector(), 1)
    vector.reset(seed=0)
    actions = np.zeros((1, *vector.single_action_space.shape), np.float32)  # type: ignore[misc]
    for _ in range(5):
        vector.step(actions)
    perception = vector.perceptions[0]
    perception.tracker._direction = 1
    observations, infos = vector.env.reset(seed=1)
    vector._perceive(observations, infos)
    assert len(perception._body) == 1
    vector.close()


def test_a_vector_without_a_camera_is_refused() -> None:
    from stair_env.env import StairClimbEnv

    vector = SyncVectorEnv([lambda: StairClimbEnv(num_steps=3)])
    with pytest.raises(ValueError, match="imu, rgb, depth"):
        PerceptionVectorWrapper(vector, None, None, StairEstimator(detector=RecordingDetector()))  # type: ignore[arg-type]
    vector.close()


def walk_both(ours: Any, theirs: Any, steps: int, compare: Any) -> None:
    actions = np.random.default_rng(0).uniform(-0.2, 0.2, (steps, 3, 16)).astype(np.float32)
    compare(ours.reset(seed=7), theirs.reset(seed=7))
    for action in actions:
        compare(ours.step(action), theirs.step(action))


def assert_same(ours: Any, theirs: Any) -> None:
    """Equal trees of dicts, tuples and arrays."""
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys()
        for key in ours:
            assert_same(ours[key], theirs[key])
    elif isinstance(ours, tuple) or (isinstance(ours, np.ndarray) and ours.dtype == object):
        assert len(ours) == len(theirs)
        for a, b in zip(ours, theirs):
            assert_same(a, b)
    else:
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_make_vec_gives_what_single_environments_give(mode: str) -> None:
    """Worker processes with one batch here, against a network in each environment; episodes end on the way."""
    kwargs: dict[str, Any] = {"max_episode_steps": 6, **OPTIONS}
    detectors = {"estimator": {"detector": RecordingDetector()}}
    ours = gym.make_vec(PERCEIVED, num_envs=3, workers=2, autoreset_mode=mode, **detectors, **kwargs)
    assert isinstance(ours, PerceptionVectorWrapper)
    one = functools.partial(gym.make, PERCEIVED, disable_env_checker=True, **detectors, **kwargs)
    theirs = SyncVectorEnv([one] * 3, autoreset_mode=AutoresetMode(mode))
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.metadata["autoreset_mode"] is AutoresetMode(mode)
    walk_both(ours, theirs, 15, assert_same)
    assert max(ours.estimator._detector.batches) == 3
    ours.close(), theirs.close()


def test_a_masked_reset_leaves_the_others_alone() -> None:
    kwargs: dict[str, Any] = {"max_episode_steps": 4, **OPTIONS}
    vector = gym.make_vec(
        PERCEIVED,
        num_envs=2,
        workers=1,
        autoreset_mode="Disabled",
        estimator={"detector": RecordingDetector()},
        **kwargs,
    )
    vector.reset(seed=0)
    actions = np.zeros((2, 16), np.float32)
    for _ in range(2):
        before = vector.step(actions)[0]
    after, infos = vector.reset(options={"reset_mask": np.array([True, False])})
    assert infos["_perceived"].tolist() == [True, False]
    np.testing.assert_array_equal(after["stair"][1], before["stair"][1])
    observations, *_, infos = vector.step(actions)
    assert infos["camera"]["time_s"] == pytest.approx([1 / 48, 3 / 48])
    assert vector.observation_space.contains(observations)
    vector.close()


def test_blocks_reach_the_gaits_in_the_workers() -> None:
    vector = make_rgbd_vec(2, workers=1, **OPTIONS)
    vector.reset(seed=[1, 1])
    blocks = np.zeros((2, 8))
    blocks[1] = [1.0, 1.0, 0.3, 0.15, 0.02, 0.0, 0.0, 1.0]
    for _ in range(30):
        vector.provide_stairs(blocks)
        observations, *_ = vector.step(np.zeros((2, 16), np.float32))
    heights = observations["proprio"][:, PROPRIO_SLICES["foothold_height"]]
    assert np.ptp(heights[0]) < 1e-6 and np.ptp(heights[1]) > 0.1
    with pytest.raises(ValueError, match=r"\(1, 8\).*\(2, 8\)"):
        vector.provide_stairs(blocks[:1])
    vector.close()
