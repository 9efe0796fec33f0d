"""What a spectator sees lies where it is, and what he does happens; no page is needed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from policies.pretrained import PolicyError
from policies.watch.session import END_STEPS, PUSH_M_S, WatchConfig, WatchSession
from stair_env.physics.visual_parts import BASE, link_poses, visual_parts


@pytest.fixture(scope="module")
def session() -> Iterator[WatchSession]:
    session = WatchSession(WatchConfig(agent="zero", riser_height=0.12, tread_depth=0.3, num_steps=3, seed=1))
    yield session
    session.close()


def test_what_was_measured_lies_on_the_true_stairs(session: WatchSession) -> None:
    session.restart()
    for _ in range(24):
        session.advance()
    points = np.concatenate(session.measured_stairs())  # of treads and risers
    corners = np.array([edge.endpoints[0][[0, 2]] for edge in session.stairs.edges()])
    gaps = np.linalg.norm(points[:, None, [0, 2]] - corners, axis=-1).min(axis=1)
    assert session.steps == 24 and len(points) > 3 and gaps.max() < 0.06
    assert abs(points[:, 1]).max() < 0.55  # drawn 0.8 m wide, before the robot
    (edge,) = session.measured_edge()
    assert abs(edge[:, 0].mean() - session.true_edges()[0][0, 0]) < 0.06


def test_time_can_be_stopped(session: WatchSession) -> None:
    session.restart()
    session.paused = True
    session.advance()
    assert session.steps == 0
    session.paused = False
    session.advance()
    assert session.steps == 1 and session.time_s == pytest.approx(1 / 48)


def test_other_stairs_come_with_the_next_flight(session: WatchSession) -> None:
    session.restart(riser_height=0.15, direction="down", num_steps=4)
    truth = session.info["truth"]
    assert (truth["riser_height"], truth["direction"], truth["num_steps"]) == (0.15, -1.0, 4)
    assert truth["tread_depth"] == 0.3  # as before
    with pytest.raises(ValueError, match="riser_height"):
        session.restart(riser_height=0.5)
    session.restart(riser_height=0.12, direction="up", num_steps=3)


@pytest.mark.parametrize(("direction", "axis", "sign"), [("forward", 0, 1), ("left", 1, 1), ("right", 1, -1)])
def test_a_push_moves_the_trunk_that_way(session: WatchSession, direction: str, axis: int, sign: int) -> None:
    session.restart()
    before = session.simulation.base_state().velocity
    session.push(direction)
    change = session.simulation.base_state().velocity - before
    assert change[axis] == pytest.approx(sign * PUSH_M_S, rel=0.05)  # it stands all but straight before the stairs
    with pytest.raises(ValueError, match="forward"):
        session.push("up")


def test_agents_take_over(session: WatchSession) -> None:
    session.restart()
    assert session.agents == ("policy", "zero", "random")
    for agent in ("random", "policy", "zero"):
        session.choose(agent)
        session.advance()
        assert bool(np.any(session.env.get_wrapper_attr("state").action)) == (agent != "zero")
    with pytest.raises(ValueError, match="random"):
        session.choose("me")


def test_after_a_flight_comes_another(session: WatchSession) -> None:
    session.restart()
    session.advance()
    session.outcome = "success"
    for _ in range(END_STEPS - 1):
        session.advance()
    assert session.outcome and session.steps == 1  # its end stays in view
    session.advance()
    assert not session.outcome and session.steps == 0


def test_the_drawn_robot_stands_where_the_robot_stands(session: WatchSession) -> None:
    simulation = session.simulation
    poses = link_poses(simulation.client, simulation.body)
    np.testing.assert_allclose(poses[BASE][0], simulation.base_state().position, atol=1e-9)
    parts = visual_parts(simulation.client, simulation.body)
    assert {part.link for part in parts} <= set(poses) and sum(part.kind == "mesh" for part in parts) > 8


def test_wrong_choices_are_named() -> None:
    for wrong, choice in (
        ({"robot": "cat"}, "aliengo"),
        ({"agent": "me"}, "zero"),
        ({"direction": "both"}, "down"),
        ({"lighting": "dusk"}, "night"),
        ({"riser_height": 0.5}, "riser_height"),
    ):
        with pytest.raises(ValueError, match=choice):
            WatchConfig(**wrong)
    with pytest.raises(PolicyError, match="aliengo"):
        WatchSession(WatchConfig(policy="nobody"))
    with pytest.raises(PolicyError, match="laikago"):
        WatchSession(WatchConfig(robot="laikago"))  # for which no policy is shipped
