"""The memory recalls what was, and knows the edges under the rear feet from the stair blocks of the past."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from policies.joint_level.teaching import TEACHER_KEY
from policies.make_env import CLIMB_ID, make_env
from stair_env.observation import PROPRIO_SLICES
from stair_env.onboard.memory import EDGES, FAR_M, LAGS, MEMORY_KEY, MOMENT_SIZE
from stair_env.robots import NUM_JOINTS
from stair_env.task.sources import front_hips

STAIRS = {"riser_height": 0.12, "tread_depth": 0.30, "num_steps": 4}
KWARGS = {"actuation": "joint", "actuator": "position", "memory": True, "teacher": True, **STAIRS}


def flight(**kwargs: Any) -> list[tuple[dict[str, np.ndarray], Any]]:
    """Observations of a flight on the teacher's actions, each with the environment's true state."""
    env = make_env(CLIMB_ID, {**KWARGS, **kwargs}, monitor=False)
    observation, info = env.reset(seed=5)
    base: Any = env.unwrapped
    seen = [(observation, base.state)]
    done = False
    while not done:
        observation, _, terminated, truncated, info = env.step(info[TEACHER_KEY])
        assert env.observation_space.contains(observation)
        seen.append((observation, base.state))
        done = terminated or truncated
    env.close()
    assert info["is_success"]
    return seen


def test_moments_are_those_of_the_past() -> None:
    seen = flight()
    action = PROPRIO_SLICES["last_action"].start
    for now in (0, 3, 40, len(seen) - 1):
        moments = seen[now][0][MEMORY_KEY][: EDGES.start].reshape(len(LAGS), MOMENT_SIZE)
        for lag, moment in zip(LAGS, moments):
            proprio = seen[max(now - lag, 0)][0]["proprio"]
            assert np.array_equal(moment[:NUM_JOINTS], proprio[action : action + NUM_JOINTS])
            assert np.array_equal(moment[NUM_JOINTS : NUM_JOINTS + 3], proprio[PROPRIO_SLICES["velocity"]])
            assert np.array_equal(moment[-4:], proprio[PROPRIO_SLICES["contact"]])


@pytest.mark.parametrize(("direction", "sign"), [("up", 1.0), ("down", -1.0)])
def test_edges_under_the_rear_feet_are_remembered(direction: str, sign: float) -> None:
    known = 0
    for observation, state in flight(direction=direction)[::5]:
        distance, rise = observation[MEMORY_KEY][EDGES][6:8]  # ahead of the rear hips
        robot, edges = state.episode.robot, state.episode.profile.edge_x
        rear = front_hips(state.after, robot, 0.0).x - (robot.hip_x[0] - robot.hip_x[1])  # within 2 cm if pitched
        ahead = edges[edges > rear]
        if np.abs(edges - rear).min() < 0.06 or not len(ahead) or ahead[0] - rear > 0.4:
            continue  # who has to guess on which side the edge is, or is far from all
        assert distance == pytest.approx(ahead[0] - rear, abs=0.06) and rise == pytest.approx(sign * 0.12, abs=0.01)
        known += 1
    assert known > 10


def test_blind_robots_remember_no_edges() -> None:
    for observation, _ in flight(stair_source="blind"):
        edges = observation[MEMORY_KEY][EDGES]
        assert np.allclose(edges, [FAR_M, 0.0, FAR_M, 0.0, FAR_M, 0.0, FAR_M, 0.0, 0.0])
