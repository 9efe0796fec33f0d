"""The staircases of an evaluation."""

from __future__ import annotations

import json

import pytest

from policies.evaluate.stair_sets import make_cells
from stair_env.common.constants import STAIR_SETS, WALKING_DIRECTIONS
from stair_env.common.validation import SpecError
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
