import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stair_env.robots import get_robot
from stair_env.stairs import StairSpec
from stair_env.task.spawn import draw_spawn, standing_at


@given(st.integers(0, 999), st.sampled_from(["up", "down"]))
def test_robots_start_with_their_feet_on_the_ground_clear_of_edges(seed, direction):
    spec, robot = StairSpec(direction=direction, riser_height=0.14), get_robot("aliengo")
    spawn = draw_spawn(spec, robot, "anywhere", np.random.default_rng(seed))
    pitch, yaw = spawn.pitch, spawn.yaw
    tip = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    feet = spawn.position + spawn.feet_in_base @ (turn @ tip).T
    profile = spec.profile()
    assert feet[:, 2] == pytest.approx(profile.height_at(feet[:, 0]) + robot.foot_radius, abs=1e-9)
    assert np.abs(feet[:, 0, None] - profile.edge_x).min() > 0.05


def test_standing_where_asked():
    spawn = standing_at(StairSpec(), get_robot("a1"), -1.0, 0.2, 0.1)
    assert spawn.position[:2] == pytest.approx([-1.0, 0.2]) and spawn.yaw == 0.1
