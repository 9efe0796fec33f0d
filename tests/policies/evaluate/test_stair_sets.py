"""The staircases of an evaluation."""

from __future__ import annotations

import json

import pytest

from policies.evaluate.stair_sets import LADDER_TREAD_M, RUNG, make_cells
from stair_env.common.constants import STAIR_SETS, WALKING_DIRECTIONS
from stair_env.common.validation import SpecError
from stair_env.env import StairClimbEnv
from stair_env.scene.paper_stairs import PAPER_STAIRS
from stair_env.stairs import StairSpec


@pytest.mark.parametrize("name", sorted(STAIR_SETS))
def test_cells_are_json_able_and_balanced(name: str) -> None:
    cells = make_cells(name)
    assert json.dumps([cell.env_kwargs for cell in cells])
    counts = [sum(cell.direction == direction for cell in cells) for direction in WALKING_DIRECTIONS]
    assert counts[0] == counts[1] > 0


def test_paper_cells_hold_the_very_stairs() -> None:
    cells = make_cells("paper", ["up"])
    for cell, stair in zip(cells, PAPER_STAIRS, strict=True):
        spec = StairSpec.from_dict(cell.options["stairs"])
        assert spec == stair.spec("up", 6)
        assert cell.riser_height == pytest.approx(spec.riser_height, abs=1e-4)


def test_unknown_names_list_the_choices() -> None:
    with pytest.raises(SpecError, match="'paper', 'grid', 'random'"):
        make_cells("spiral")
    with pytest.raises(SpecError, match="'up', 'down'"):
        make_cells("grid", ["sideways"])


def test_a_grid_of_ones_own() -> None:
    cells = make_cells("grid", ["down"], risers=(0.06, 0.12), treads=(0.3,))
    assert [(cell.direction, cell.riser_height, cell.tread_depth) for cell in cells] == [
        ("down", 0.06, 0.3),
        ("down", 0.12, 0.3),
    ]
    with pytest.raises(SpecError, match="risers"):
        make_cells("grid", risers=(1.0,))


@pytest.mark.parametrize(("robot", "lowest", "highest"), [("aliengo", 0.15, 0.23), ("a1", 0.12, 0.20)])
def test_ladder_reaches_as_high_as_a_robots_legs_ask(robot: str, lowest: float, highest: float) -> None:
    rungs = [cell for cell in make_cells("ladder", ["up"], robot=robot) if cell.condition == RUNG]
    assert [rungs[0].riser_height, rungs[-1].riser_height] == [lowest, highest]
    assert all(cell.tread_depth == LADDER_TREAD_M for cell in rungs)


def test_conditions_of_the_ladder_are_what_they_are_called() -> None:
    cells = {cell.condition: cell for cell in make_cells("ladder", ["down"])}
    assert set(cells) == {RUNG, "steep", "push_0.6", "push_1.0", "everything"}
    env = StairClimbEnv(**cells["push_1.0"].env_kwargs)
    assert (env.randomization.push_speed, env.randomization.push_interval_s) == (1.0, 2.0)
    assert env.randomization.friction == (0.9, 0.9) and env.randomization.command_latency == 0.0
    wild = StairClimbEnv(**cells["everything"].env_kwargs)
    assert wild.randomization.payload_kg == (-0.5, 5.0) and wild.ranges.uneven > 0.0
    steep = StairClimbEnv(**cells["steep"].env_kwargs).ranges
    assert (steep.riser_height, steep.tread_depth) == ((0.18, 0.20), (0.22, 0.25))


def test_only_the_ladder_knows_the_robot() -> None:
    assert make_cells("grid", robot="a1") == make_cells("grid", robot="aliengo")
    with pytest.raises(SpecError, match="aliengo"):
        make_cells("ladder", robot="cat")
