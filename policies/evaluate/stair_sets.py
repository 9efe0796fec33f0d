"""The sets of staircases that policies are evaluated on."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from stair_env.common.constants import RISER_RANGE_M, STAIR_SETS, TREAD_RANGE_M, WALKING_DIRECTIONS
from stair_env.common.validation import check_choice, check_range
from stair_env.scene.paper_stairs import PAPER_STAIRS

NUM_STEPS = 6
GRID_RISERS_M = (0.08, 0.11, 0.14, 0.17)
GRID_TREADS_M = (0.25, 0.30, 0.35)
RANDOM_RISER_M = (0.08, 0.17)
RANDOM_TREAD_M = (0.25, 0.35)
RANDOM_NUM_STEPS = (4, 7)
Size = float | tuple[float, float]


@dataclass(frozen=True)
class Cell:
    """Staircases that count together.

    Attributes:
        direction: "up" or "down".
        riser_height, tread_depth: metres, one number or (low, high).
        num_steps: one number or (low, high).
        name: of the staircase, "" when it has none.
        options: of `env.reset`; holds the very staircase where ranges do not describe it.
    """

    direction: str
    riser_height: Size
    tread_depth: Size
    num_steps: int | tuple[int, int] = NUM_STEPS
    name: str = ""
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """Keyword arguments of the environment."""
        names = ("direction", "riser_height", "tread_depth", "num_steps")
        return {name: getattr(self, name) for name in names}


def _paper(direction: str) -> list[Cell]:
    cells = []
    for stair in PAPER_STAIRS:
        spec = stair.spec(direction, NUM_STEPS)  # type: ignore[arg-type]
        size = round(stair.riser_height, 4), round(stair.tread_depth, 4)
        cells.append(Cell(direction, *size, name=stair.name, options={"stairs": dataclasses.asdict(spec)}))
    return cells


def _random(direction: str) -> list[Cell]:
    return [Cell(direction, RANDOM_RISER_M, RANDOM_TREAD_M, RANDOM_NUM_STEPS)]


def make_cells(
    stairs: str,
    directions: Iterable[str] = WALKING_DIRECTIONS,
    risers: Sequence[float] = GRID_RISERS_M,
    treads: Sequence[float] = GRID_TREADS_M,
) -> list[Cell]:
    """Cells of a set, for each direction.

    Args:
        stairs: "paper" (the six of table 7), "grid" (risers x treads) or "random".
        directions: any of "up", "down".
        risers, treads: of the grid, metres.

    Raises:
        SpecError: unknown set or direction, or a size that no staircase has (a ValueError).
    """
    check_choice("stairs", stairs, STAIR_SETS)
    cells: list[Cell] = []
    for direction in directions:
        check_choice("direction", direction, WALKING_DIRECTIONS)
        if stairs == "paper":
            cells.extend(_paper(direction))
        elif stairs == "random":
            cells.extend(_random(direction))
        else:
            for riser in risers:
                check_range("risers", riser, *RISER_RANGE_M)
                for tread in treads:
                    check_range("treads", tread, *TREAD_RANGE_M)
                    cells.append(Cell(direction, riser, tread))
    return cells
