"""Flights for the Rerun viewer: what is drawn lies where it should, and a whole flight goes into a file."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import stair_env  # noqa: F401
from policies.report.flight_log import FlightLog, next_edge, nosings, open_flights
from policies.rollout import ZeroAction, run_episode
from stair_env.stairs import StairSpec


@pytest.mark.parametrize("direction", ["up", "down"])
def test_true_edges_are_the_nosings(direction: str) -> None:
    spec = StairSpec(direction=direction, riser_height=0.15, tread_depth=0.3, num_steps=3)  # type: ignore[arg-type]
    drawn = nosings(spec)
    convex = [edge.endpoints[0][[0, 2]] for edge in spec.edges() if edge.kind == "convex"]
    np.testing.assert_allclose([line[0, [0, 2]] for line in drawn], convex, atol=1e-9)


def test_the_measured_edge_lies_ahead_of_the_hips() -> None:
    truth = {"position": [1.0, 2.0, 0.4], "yaw": np.pi / 2}
    block = {"valid": 1.0, "edge_distance": 0.3, "heading_error": 0.0}
    (line,) = next_edge(block, truth, hip_forward_m=0.25, half_m=0.5)
    np.testing.assert_allclose(line.mean(axis=0), [1.0, 2.55, 0.4], atol=1e-9)
    assert next_edge({**block, "valid": 0.0}, truth, 0.25) == []


def test_a_flight_goes_into_a_file(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="recordings for Rerun need the extra stair-env[rerun]")
    env = gym.make("stair_env/StairClimb-v0", riser_height=0.1, num_steps=2, max_episode_steps=20)
    path = tmp_path / "flight.rrd"
    with open_flights(path) as opened:
        log = FlightLog(opened, env, start_s=3.0)
        episode = run_episode(env, ZeroAction(env.action_space), 0, on_step=log.add)
    env.close()
    assert log.time_s == pytest.approx(3.0 + (episode.control_steps + 1) / 48)
    data = path.read_bytes()
    for name in (b"world/true", b"world/robot", b"block/size/step_height_true", b"reward/"):
        assert name in data, name
