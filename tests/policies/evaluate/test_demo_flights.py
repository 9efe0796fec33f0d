"""The demo: flights in turn, a video, a summary."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import pytest

from policies.evaluate.demo_flights import DemoConfig, run_demo
from policies.make_env import CLIMB_ID, make_vec_env, normalise
from policies.report.film import HOLD_FRAMES
from policies.train.checkpoints import save_policy
from policies.train.training import algorithm_class


@pytest.fixture(scope="module")
def untrained_policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy that fits the climbing environments and knows nothing."""
    venv = normalise(make_vec_env(CLIMB_ID, 1, kind="dummy"), gamma=0.99)
    folder = tmp_path_factory.mktemp("policy")
    save_policy(algorithm_class("ppo")("MultiInputPolicy", venv, n_steps=64, device="cpu"), folder)
    venv.close()
    return folder


def test_directions_change_first_then_the_light() -> None:
    config = DemoConfig(direction="both", lighting="both")
    flights = [tuple(config.flight(index).values()) for index in range(5)]
    assert flights == [("up", "day"), ("down", "day"), ("up", "night"), ("down", "night"), ("up", "day")]
    assert [DemoConfig(direction="up").flight(index)["lighting"] for index in range(3)] == ["day", "night", "day"]


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"direction": "sideways"}, "'up', 'down', 'both'"),
        ({"lighting": "dusk"}, "'day', 'night', 'both'"),
        ({"episodes": 0}, "episodes=0"),
    ],
)
def test_wrong_values_are_named(wrong: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        DemoConfig(**wrong)


def test_video_and_summary_tell_the_same_flights(untrained_policy: Path, tmp_path: Path) -> None:
    config = DemoConfig(policy=str(untrained_policy), episodes=2, env_kwargs={"max_episode_steps": 8})
    steps: list[None] = []
    summary = run_demo(config, tmp_path, lambda: steps.append(None))
    assert summary["episodes"] == len(summary["flights"]) == 2
    assert summary["success_rate"] == 0.0
    assert {flight["termination"] for flight in summary["flights"]} == {"time_limit"}
    assert len(steps) == 2 * (8 + 1)
    assert set(summary["rmse_mm"]) >= {"width", "height"}
    with imageio.get_reader(summary["video"]) as reader:
        assert reader.count_frames() == 2 * (3 + HOLD_FRAMES)  # steps 0, 4 and 8, then the outcome
        assert reader.get_data(0).shape == (544, 1280, 3)
    assert [path.name for path in tmp_path.iterdir()] == ["demo.mp4"]


def test_nothing_is_left_of_a_demo_that_failed(untrained_policy: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="robot='cat'"):
        run_demo(DemoConfig(policy=str(untrained_policy), robot="cat"), tmp_path)
    assert not list(tmp_path.iterdir())
