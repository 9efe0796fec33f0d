"""Errors of the tracked staircase on a walking robot."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import stair_env  # noqa: F401  (registers the environment ids)
from perception.reproduction.walking import LiveConfig, WalkErrors, walk
from stair_env.observation import STAIR_FIELDS, StairBlock
from stair_env.stairs import StairSpec
from stair_env_cli.main import main

TRUE = StairBlock(1.0, 1.0, 0.30, 0.15, 0.8, 0.0, 0.0, 1.0)


def truth(**changes: float) -> dict[str, Any]:
    return TRUE._replace(**changes)._asdict()


def test_errors_are_root_mean_squares() -> None:
    errors = WalkErrors(walks=1)
    errors.add(TRUE._replace(step_width=0.303, step_height=0.146, edge_distance=0.81), truth())
    errors.add(TRUE._replace(step_width=0.304, step_height=0.153, edge_distance=0.79), truth())
    row = errors.row()
    assert row["width_rmse_mm"] == pytest.approx(np.sqrt(12.5), abs=0.01)
    assert row["height_rmse_mm"] == pytest.approx(np.sqrt(12.5), abs=0.01)
    assert row["next_edge_rmse_mm"] == pytest.approx(10.0, abs=0.01)
    assert row["valid"] == row["same_edge"] == 1.0


def test_only_steps_in_range_of_stairs_count() -> None:
    errors = WalkErrors()
    errors.add(TRUE, truth(edge_distance=1.6))
    errors.add(TRUE, truth(valid=0.0))
    assert errors.counted == 0 and errors.row()["width_rmse_mm"] is None
    errors.add(StairBlock(), truth(edge_distance=1.4))
    errors.add(TRUE, truth())
    assert errors.row()["valid"] == 0.5


def test_another_edge_is_not_an_error_of_distance_but_is_said() -> None:
    errors = WalkErrors()
    errors.add(TRUE._replace(edge_distance=0.29), truth(edge_distance=0.0))  # the edge is passed early
    errors.add(TRUE._replace(edge_distance=0.02), truth(edge_distance=0.0))
    row = errors.row()
    assert row["same_edge"] == 0.5 and row["next_edge_rmse_mm"] == pytest.approx(20.0)


def test_joining_is_counting_all() -> None:
    parts, whole = [WalkErrors(1), WalkErrors(1, 1)], WalkErrors(2, 1)
    for index, block in enumerate((TRUE._replace(step_width=0.31), TRUE._replace(step_height=0.16))):
        parts[index].add(block, truth())
        whole.add(block, truth())
    parts[0].join(parts[1])
    assert parts[0].row() == whole.row()


@pytest.mark.parametrize(
    "wrong", [{"drivers": ("seen",)}, {"flights": 0}, {"backend": "tpu"}, {"robot": "cat"}, {"workers": 0}]
)
def test_wrong_settings_are_named(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong)).rstrip("s")):
        LiveConfig(**wrong)


def test_the_ideal_network_does_not_walk() -> None:
    assert main(["measure", "--walking", "--network", "ideal"]) != 0


@pytest.fixture(scope="module")
def env() -> Iterator[gym.Env]:
    made = gym.make("stair_env/StairClimbPerception-v0", disable_env_checker=True, max_episode_steps=60)
    yield made
    made.close()


@pytest.mark.parametrize("driver", ["tracked", "true"])
def test_a_walking_robot_knows_the_stairs_ahead(env: gym.Env, driver: str) -> None:
    spec = StairSpec(riser_height=0.14, tread_depth=0.30, num_steps=4)
    errors = walk(env, driver, 3, {"stairs": dataclasses.asdict(spec)})
    row = errors.row()
    assert errors.counted > 20 and row["valid"] > 0.8
    assert row["width_rmse_mm"] < 20.0 and row["height_rmse_mm"] < 15.0


def test_true_stairs_are_what_the_gait_reads(env: gym.Env) -> None:
    given: list[StairBlock] = []
    base: Any = env.unwrapped
    original = base.provide_stair

    def provide(block: StairBlock) -> None:
        given.append(block)
        original(block)

    base.provide_stair = provide
    try:
        walk(env, "true", 3, {"stairs": dataclasses.asdict(StairSpec(num_steps=4))})
    finally:
        del base.provide_stair
    last = given[-2]  # what was handed over right before the last step; perception hands its own over after it
    assert isinstance(last, StairBlock) and last.age == 0.0 and len(last) == len(STAIR_FIELDS)
