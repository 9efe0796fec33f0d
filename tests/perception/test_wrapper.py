"""The wrapper on a scripted environment, and on the real one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

from perception.geometry.results import Nosing, StairEstimate, StepMeasurement
from perception.wrapper import PerceptionWrapper
from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.observation import PROPRIO_SIZE, PROPRIO_SLICES, STAIR_FIELDS, StairBlock, proprio_space, stair_space
from stair_env.robots import ROBOTS

CAMERA = D435I_COLOR_MODES["640x480"].scaled(64, 48)
DT = 1.0 / 48.0
SPEED = 0.5
FIRST_EDGE = 1.5  # ahead of the base at the start
ROBOT = ROBOTS["aliengo"]


class ScriptedEnv(gym.Env[dict[str, np.ndarray], np.ndarray]):
    """Walks straight at a staircase; a frame every fourth step, two steps late."""

    def __init__(self) -> None:
        self.robot, self.camera_intrinsics = ROBOT, CAMERA
        self.observation_space = spaces.Dict(
            {
                "proprio": proprio_space(),
                "imu": spaces.Box(-100.0, 100.0, (5, 6), np.float32),
                "rgb": spaces.Box(0, 255, (48, 64, 3), np.uint8),
                "depth": spaces.Box(0.0, 65.0, (48, 64), np.float32),
            }
        )
        self.action_space = spaces.Box(-1.0, 1.0, (16,), np.float32)
        self.blocks: list[StairBlock] = []

    def provide_stair(self, block: StairBlock) -> None:
        self.blocks.append(block)

    def _answer(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        pitch = ROBOT.camera.pitch_down_rad
        proprio = np.zeros(PROPRIO_SIZE, np.float32)
        proprio[PROPRIO_SLICES["velocity"]] = [SPEED if self.steps else 0.0, 0.0, 0.0]
        force = [0.0, -9.8 * np.cos(pitch), -9.8 * np.sin(pitch)]
        observation = {
            "proprio": proprio,
            "imu": np.tile(np.array([*force, 0.0, 0.0, 0.0], np.float32), (5, 1)),
            "rgb": np.zeros((48, 64, 3), np.uint8),
            "depth": np.ones((48, 64), np.float32),
        }
        number = max(self.steps - 2, 0) // 4
        captured = number * 4 * DT
        camera = {"frame": number, "captured_at_s": captured, "time_s": self.steps * DT}
        return observation, {"camera": camera, "truth": {}}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.steps = 0
        return self._answer()

    def step(self, action: np.ndarray) -> Any:
        self.steps += 1
        observation, info = self._answer()
        return observation, 0.0, False, False, info


class ScriptedEstimator:
    """Knows where the camera was when the frame was captured."""

    def __init__(self, env: ScriptedEnv) -> None:
        self.env, self.calls = env, 0
        self.gravities: list[np.ndarray] = []

    def estimate(self, rgb: np.ndarray, depth: np.ndarray, intrinsics: Any, gravity: np.ndarray) -> StairEstimate:
        self.calls += 1
        self.gravities.append(gravity)
        captured = max(self.env.steps - 2, 0) // 4 * 4 * DT
        ahead = FIRST_EDGE - SPEED * captured - ROBOT.camera.position[0]
        nosings = tuple(
            Nosing(ahead + 0.3 * i, 0.005, 0.0, 0.005, 0.14, 0.003, 0.3, 0.004)
            for i in range(3)
            if ahead + 0.3 * i > 0.3
        )
        steps = tuple(StepMeasurement(0.3, 0.14, 0.004, 0.003, n.distance_m) for n in nosings)
        return StairEstimate(True, 1, (), steps, nosings, next_edge_m=ahead, yaw_std_rad=0.01)


@pytest.fixture()
def wrapped() -> SimpleNamespace:
    env = ScriptedEnv()
    estimator = ScriptedEstimator(env)
    return SimpleNamespace(env=env, estimator=estimator, top=PerceptionWrapper(env, estimator))  # type: ignore[arg-type]


def test_spaces_are_those_of_the_oracle_environment(wrapped: SimpleNamespace) -> None:
    assert wrapped.top.observation_space == spaces.Dict({"proprio": proprio_space(), "stair": stair_space()})
    observation, _ = wrapped.top.reset(seed=0)
    assert wrapped.top.observation_space.contains(observation)
    for _ in range(20):
        observation, *_ = wrapped.top.step(np.zeros(16, np.float32))
        assert wrapped.top.observation_space.contains(observation)


def test_the_network_runs_once_a_frame(wrapped: SimpleNamespace) -> None:
    wrapped.top.reset(seed=0)
    for _ in range(41):
        wrapped.top.step(np.zeros(16, np.float32))
    assert wrapped.estimator.calls == 1 + (41 - 2) // 4


def test_the_block_is_right_in_spite_of_latency_and_goes_back_to_the_gait(wrapped: SimpleNamespace) -> None:
    observation, info = wrapped.top.reset(seed=0)
    for _ in range(60):
        observation, *_, info = wrapped.top.step(np.zeros(16, np.float32))
    block = dict(zip(STAIR_FIELDS, observation["stair"].tolist()))
    expected = FIRST_EDGE - SPEED * 60 * DT - ROBOT.hip_x[0]
    assert block["valid"] == 1.0
    assert block["edge_distance"] == pytest.approx(expected, abs=0.015)
    assert block["step_width"] == pytest.approx(0.3, abs=1e-3)
    assert block["step_height"] == pytest.approx(0.14, abs=1e-3)
    assert np.array_equal(wrapped.env.blocks[-1].as_array(), observation["stair"])
    assert len(wrapped.env.blocks) == 61
    assert info["perceived"]["block"].tolist() == observation["stair"].tolist()


def test_gravity_is_that_of_the_imu(wrapped: SimpleNamespace) -> None:
    wrapped.top.reset(seed=0)
    for _ in range(20):
        wrapped.top.step(np.zeros(16, np.float32))
    pitch = ROBOT.camera.pitch_down_rad
    for gravity in wrapped.estimator.gravities:
        assert gravity == pytest.approx([0.0, -9.8 * np.cos(pitch), -9.8 * np.sin(pitch)], abs=0.05)


def test_a_new_episode_forgets_the_last_one(wrapped: SimpleNamespace) -> None:
    first = [wrapped.top.reset(seed=0)[0]["stair"]]
    first += [wrapped.top.step(np.zeros(16, np.float32))[0]["stair"] for _ in range(30)]
    second = [wrapped.top.reset(seed=0)[0]["stair"]]
    second += [wrapped.top.step(np.zeros(16, np.float32))[0]["stair"] for _ in range(30)]
    assert np.array_equal(first, second)


def test_an_environment_without_a_camera_is_refused() -> None:
    class Blind(gym.Env[Any, Any]):
        observation_space = spaces.Dict({"proprio": proprio_space()})
        action_space = spaces.Box(-1.0, 1.0, (16,), np.float32)

    with pytest.raises(ValueError, match="imu, rgb, depth"):
        PerceptionWrapper(Blind(), object())  # type: ignore[arg-type]


class NothingDetector:
    """Sees no line, ever."""

    def detect(self, rgb: Any, depth_m: Any) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((len(rgb), 32, 16)), np.zeros((len(rgb), 32, 16, 8))


def test_on_the_real_environment_same_seed_same_rollout() -> None:
    from perception.estimator import StairEstimator
    from stair_env.rgbd import StairClimbRgbdEnv

    def rollout() -> list[np.ndarray]:
        env = PerceptionWrapper(StairClimbRgbdEnv(camera={"width": 160}), StairEstimator(detector=NothingDetector()))
        observation, info = env.reset(seed=3)
        seen = [observation["proprio"], observation["stair"]]
        for _ in range(10):
            observation, *_, info = env.step(np.zeros(env.action_space.shape, np.float32))
            assert env.observation_space.contains(observation)
            seen += [observation["proprio"], observation["stair"]]
        assert info["perceived"]["valid"] is False
        env.close()
        return seen

    first, second = rollout(), rollout()
    assert all(np.array_equal(a, b) for a, b in zip(first, second))
