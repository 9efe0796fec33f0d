"""The sets of staircases that policies are evaluated on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from stair_env.common.constants import RISER_RANGE_M, STAIR_SETS, TREAD_RANGE_M, WALKING_DIRECTIONS
from stair_env.common.validation import check_choice, check_range
from stair_env.robots import DEFAULT_ROBOT, get_robot
from stair_env.scene.paper_stairs import PAPER_STAIRS
from stair_env.task.randomization import NOMINAL

NUM_STEPS = 6
GRID_RISERS_M = (0.08, 0.11, 0.14, 0.17)
GRID_TREADS_M = (0.25, 0.30, 0.35)
RANDOM_RISER_M = (0.08, 0.17)
RANDOM_TREAD_M = (0.25, 0.35)
RANDOM_NUM_STEPS = (4, 7)
Size = float | tuple[float, float]


@dataclass(frozen=True)
class Ladder:
    """How high the rungs are, which depends on the length of the legs.

    Attributes:
        rungs: risers, metres.
        steep: risers of the steep stairs, low and high, metres.
        ordinary: risers of the flights on which something else is hard, metres.
        payload_kg: the heaviest, where everything is random.
    """

    rungs: tuple[float, ...]
    steep: tuple[float, float]
    ordinary: tuple[float, float]
    payload_kg: float


# Rungs end where the bare gait arrives in a quarter of the flights or none (docs/climbing.md). For short legs steep
# stairs have lower risers, in proportion.
LONG_LEGS = Ladder((0.15, 0.17, 0.20, 0.23), (0.18, 0.20), (0.12, 0.17), 5.0)  # AlienGo, Laikago
SHORT_LEGS = Ladder((0.12, 0.15, 0.18, 0.20), (0.14, 0.16), (0.08, 0.12), 3.0)  # A1, Mini Cheetah
LONG_LEG_M = 0.45  # thigh and shank; AlienGo has 0.50, A1 0.40
LADDER_TREAD_M = (0.25, 0.32)
STEEP_TREAD_M = (0.22, 0.25)
LADDER_UNEVEN_M = 0.015
PUSH_SPEEDS_M_S = (0.6, 1.0)
PUSH_INTERVAL_S = 2.0
RUNG = "rung"  # the condition of a cell where nothing but the riser is hard


@dataclass(frozen=True)
class Cell:
    """Staircases that count together.

    Attributes:
        direction: "up" or "down".
        riser_height, tread_depth: metres, one number or (low, high).
        num_steps: one number or (low, high).
        name: of the staircase, "" when it has none.
        condition: what is hard about it, "" outside the ladder.
        world: further arguments of the environment.
        options: of `env.reset`; holds the very staircase where ranges do not describe it.
    """

    direction: str
    riser_height: Size
    tread_depth: Size
    num_steps: int | tuple[int, int] = NUM_STEPS
    name: str = ""
    condition: str = ""
    world: Mapping[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """Keyword arguments of the environment."""
        names = ("direction", "riser_height", "tread_depth", "num_steps")
        return {name: getattr(self, name) for name in names} | dict(self.world)


def _paper(direction: str) -> list[Cell]:
    cells = []
    for stair in PAPER_STAIRS:
        spec = stair.spec(direction, NUM_STEPS)  # type: ignore[arg-type]
        size = round(stair.riser_height, 4), round(stair.tread_depth, 4)
        cells.append(Cell(direction, *size, name=stair.name, options={"stairs": asdict(spec)}))
    return cells


def _random(direction: str) -> list[Cell]:
    return [Cell(direction, RANDOM_RISER_M, RANDOM_TREAD_M, RANDOM_NUM_STEPS)]


def ladder_of(robot: str) -> Ladder:
    """The ladder for a robot's legs.

    Raises:
        SpecError: no such robot.
    """
    spec = get_robot(robot)
    return LONG_LEGS if spec.upper_length + spec.lower_length >= LONG_LEG_M else SHORT_LEGS


def _ladder(direction: str, ladder: Ladder) -> list[Cell]:
    """Rungs on which the riser alone is hard, then conditions by name; treads are drawn for each flight."""
    cells = [Cell(direction, riser, LADDER_TREAD_M, condition=RUNG) for riser in ladder.rungs]
    cells.append(Cell(direction, ladder.steep, STEEP_TREAD_M, condition="steep"))
    nominal = {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(NOMINAL).items()}
    for speed in PUSH_SPEEDS_M_S:
        pushes = {"push_speed": speed, "push_interval_s": PUSH_INTERVAL_S}
        world: dict[str, Any] = {"randomization": {**nominal, **pushes}}
        cells.append(Cell(direction, ladder.ordinary, LADDER_TREAD_M, condition=f"push_{speed}", world=world))
    everything: dict[str, Any] = {
        "friction": [0.5, 1.1],
        "payload_kg": [-0.5, ladder.payload_kg],
        "motor_strength": [0.75, 1.1],
        "push_speed": PUSH_SPEEDS_M_S[0],
        "push_interval_s": PUSH_INTERVAL_S,
        "command_latency": 0.2,
    }
    world = {"randomization": everything, "uneven": LADDER_UNEVEN_M}
    return [*cells, Cell(direction, ladder.ordinary, LADDER_TREAD_M, condition="everything", world=world)]


def make_cells(
    stairs: str,
    directions: Iterable[str] = WALKING_DIRECTIONS,
    risers: Sequence[float] = GRID_RISERS_M,
    treads: Sequence[float] = GRID_TREADS_M,
    robot: str = DEFAULT_ROBOT,
) -> list[Cell]:
    """Cells of a set, for each direction.

    Args:
        stairs: "paper" (the six of table 7), "grid" (risers x treads), "random", or "ladder" (where the gait ends).
        directions: any of "up", "down".
        risers, treads: of the grid, metres.
        robot: whose ladder.

    Raises:
        SpecError: unknown set, robot or direction, or a size that no staircase has (a ValueError).
    """
    check_choice("stairs", stairs, STAIR_SETS)
    cells: list[Cell] = []
    for direction in directions:
        check_choice("direction", direction, WALKING_DIRECTIONS)
        if stairs == "paper":
            cells.extend(_paper(direction))
        elif stairs == "ladder":
            cells.extend(_ladder(direction, ladder_of(robot)))
        elif stairs == "random":
            cells.extend(_random(direction))
        else:
            for riser in risers:
                check_range("risers", riser, *RISER_RANGE_M)
                for tread in treads:
                    check_range("treads", tread, *TREAD_RANGE_M)
                    cells.append(Cell(direction, riser, tread))
    return cells
