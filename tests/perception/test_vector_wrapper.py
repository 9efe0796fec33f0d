"""Many environments, one batch: the same answers as one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

from perception.estimator import StairEstimator
from perception.vector_wrapper import PerceptionVectorWrapper, make_perception_vector
from perception.wrapper import PerceptionWrapper
from stair_env.rgbd import StairClimbRgbdEnv

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
        assert len(infos["perceived"]) == 2
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


def test_maker() -> None:
    vector = make_perception_vector(1, estimator={"detector": RecordingDetector()}, **OPTIONS)
    observations, _ = vector.reset(seed=0)
    assert observations["stair"].shape == (1, 8)
    vector.close()
