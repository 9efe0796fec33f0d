"""Checking a results file before its line joins the benchmark's table.

The table is only worth something if each line was flown on the same flights and counted in the same way. Everything
that can be worked out again from the file is worked out again here.
"""

from __future__ import annotations

import datetime
import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from policies import pretrained
from policies.evaluate.evaluation import OUTCOMES_KEY
from policies.evaluate.leaderboard import GAIT, LADDER, Row, read_rows, rows_of
from policies.evaluate.stair_sets import make_cells
from policies.rollout import CONTROLS
from policies.statistics import wilson_interval
from stair_env.common.constants import EVALUATION_SOURCES, WALKING_DIRECTIONS
from stair_env.robots import get_robot

LEAST_FLIGHTS = 30  # a cell, as the table's own lines
TOLERANCE = 1e-6  # of numbers that a file repeats
MACHINE_FIELDS = ("system", "cpu", "cores", "python")
CELL_TYPES: dict[str, tuple[type, ...]] = {
    "source": (str,),
    "direction": (str,),
    "condition": (str,),
    "riser_height": (int, float, list),
    "tread_depth": (int, float, list),
    "num_steps": (int,),
    "episodes": (int,),
    "successes": (int,),
    "success_rate": (int, float),
    "ci95": (list,),
    "steps_climbed_fraction": (int, float),
    "terminations": (dict,),
    OUTCOMES_KEY: (str,),
}
FAULTS = {
    "schema": "a field is missing or of another type",
    "provenance": "seed, commit, date or machine do not say where the results come from",
    "policy": "the line has no name of its own",
    "robot": "no such robot",
    "cells": "not each cell of the robot's ladder once, up and down",
    "flights": f"fewer than {LEAST_FLIGHTS} flights a cell, or cells with different numbers of them",
    "seed": "other flights than those of the table",
    "outcomes": "counts do not follow from the outcomes",
    "interval": "the 95 % interval is not Wilson's of the outcomes",
    "overall": "sums over the cells differ from what the file says",
}


@dataclass(frozen=True)
class Fault:
    """What is wrong with a file.

    Attributes:
        name: one of FAULTS.
        text: where, and what was expected.
    """

    name: str
    text: str

    def __str__(self) -> str:
        return f"{self.name}: {self.text}"


class SubmissionError(ValueError):
    """A results file that cannot join the table.

    Attributes:
        faults: all that were found.
    """

    def __init__(self, path: Path | str, faults: Sequence[Fault]) -> None:
        self.faults = tuple(faults)
        count = "a fault" if len(faults) == 1 else f"{len(faults)} faults"
        super().__init__(f"{path} has {count}; {'; '.join(map(str, faults))}")


def read_submission(path: Path | str, name: str | None = None, table: Path | str | None = None) -> list[Row]:
    """Rows of a results file that may join the table.

    Args:
        path: JSON of `stair-env evaluate --stairs ladder`.
        name: of the policy in the table; None keeps what the file says.
        table: `benchmark.json` that the line would join; None checks the file alone.

    Raises:
        SubmissionError: with every fault that was found.
        FileNotFoundError: no such file.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise SubmissionError(path, [Fault("schema", f"not JSON: {error}")]) from None
    known = read_rows(table) if table is not None and Path(table).is_file() else []
    faults = list(find_faults(content, name, known))
    if faults:
        raise SubmissionError(path, faults)
    return rows_of(content, name)


def find_faults(content: Any, name: str | None = None, known: Sequence[Row] = ()) -> Iterator[Fault]:
    """What is wrong with a results file.

    Args:
        content: of the file.
        name: of the policy in the table.
        known: rows of the table.
    """
    broken = list(_schema_faults(content))
    if broken:
        yield from broken  # the other checks read these fields
        return
    yield from _provenance_faults(content)
    yield from _name_faults(content, name, known)
    try:
        get_robot(content["robot"])
    except ValueError as error:
        yield Fault("robot", str(error))
        return
    yield from _cell_faults(content)
    yield from _flight_faults(content, known)
    for cell in content["cells"]:
        yield from _outcome_faults(cell)
    yield from _overall_faults(content)


def _schema_faults(content: Any) -> Iterator[Fault]:
    if not isinstance(content, dict):
        yield Fault("schema", f"holds {type(content).__name__}, expected a JSON object")
        return
    if content.get("stairs") != LADDER:
        yield Fault("schema", f"stairs={content.get('stairs')!r}, expected {LADDER!r}: `evaluate --stairs {LADDER}`")
    if not isinstance(content.get("robot"), str):
        yield Fault("schema", f"robot={content.get('robot')!r}, expected a name")
    if not isinstance(content.get("overall"), dict):
        yield Fault("schema", "overall is missing")
    cells = content.get("cells")
    if not isinstance(cells, list) or not cells:
        yield Fault("schema", "cells is missing or empty")
        return
    for index, cell in enumerate(cells):
        if not isinstance(cell, dict):
            yield Fault("schema", f"cells[{index}] is no JSON object")
            continue
        for field, types in CELL_TYPES.items():
            if not isinstance(cell.get(field), types) or isinstance(cell.get(field), bool):
                wanted = " or ".join(kind.__name__ for kind in types)
                yield Fault("schema", f"cells[{index}].{field}={cell.get(field)!r}, expected {wanted}")
        if isinstance(cell.get("source"), str) and cell["source"] not in EVALUATION_SOURCES:
            known = ", ".join(EVALUATION_SOURCES)
            yield Fault("schema", f"cells[{index}].source={cell['source']!r}, expected one of {known}")


def _provenance_faults(content: Mapping[str, Any]) -> Iterator[Fault]:
    seed = content.get("seed")
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        yield Fault("provenance", f"seed={seed!r}, expected a whole number >= 0")
    if not isinstance(content.get("commit"), str) or not content["commit"]:
        yield Fault("provenance", f"commit={content.get('commit')!r}, expected what `evaluate` wrote")
    try:
        date = datetime.datetime.fromisoformat(content.get("date"))  # type: ignore[arg-type]
        late = date - datetime.datetime.now(date.tzinfo) > datetime.timedelta(days=1)
        if late:
            yield Fault("provenance", f"date={content['date']!r} lies ahead")
    except (TypeError, ValueError):
        yield Fault("provenance", f"date={content.get('date')!r}, expected a date and time in ISO 8601")
    machine = content.get("machine")
    lacking = [field for field in MACHINE_FIELDS if not isinstance(machine, dict) or not machine.get(field)]
    if lacking:
        yield Fault("provenance", f"machine lacks {', '.join(lacking)}")


def _name_faults(content: Mapping[str, Any], name: str | None, known: Sequence[Row]) -> Iterator[Fault]:
    flown = [policy for policy in (content.get("policy"), content.get("blind_policy")) if policy is not None]
    chosen = name if name is not None else next(iter(flown), None)
    taken = {*pretrained.names(), *CONTROLS, GAIT, *(row["policy"] for row in known)}
    if chosen is None:
        yield Fault("policy", "no policy flew")
    elif "/" in chosen or "\\" in chosen:
        yield Fault("policy", f"{chosen!r} is a path; give the line a name: NAME=FILE")
    elif chosen in taken:
        yield Fault("policy", f"{chosen!r} is taken; give the line a name of its own: NAME=FILE")


def _key(cell: Mapping[str, Any]) -> str:
    return json.dumps([cell[field] for field in ("direction", "condition", "riser_height", "tread_depth", "num_steps")])


def _where(cell: Mapping[str, Any]) -> str:
    return f"{cell['source']} {cell['direction']} {cell['condition']} {cell['riser_height']}"


def _cell_faults(content: Mapping[str, Any]) -> Iterator[Fault]:
    ladder = make_cells(LADDER, WALKING_DIRECTIONS, robot=content["robot"])
    wanted = {_key(vars(cell)): f"{cell.direction} {cell.condition} {cell.riser_height}" for cell in ladder}
    for source in dict.fromkeys(cell["source"] for cell in content["cells"]):
        found = Counter(_key(cell) for cell in content["cells"] if cell["source"] == source)
        for key in wanted.keys() - found.keys():
            yield Fault("cells", f"{source} lacks {wanted[key]}")
        for key in found.keys() - wanted.keys():
            yield Fault("cells", f"{source} has {key}, which is no cell of the ladder of {content['robot']!r}")
        for key, count in found.items():
            if count > 1:
                yield Fault("cells", f"{source} has {wanted.get(key, key)} {count} times")


def _flight_faults(content: Mapping[str, Any], known: Sequence[Row]) -> Iterator[Fault]:
    counts = sorted({cell["episodes"] for cell in content["cells"]})
    if counts[0] < LEAST_FLIGHTS:
        yield Fault("flights", f"{counts[0]} a cell, expected at least {LEAST_FLIGHTS} (--episodes {LEAST_FLIGHTS})")
    if len(counts) > 1:
        yield Fault("flights", f"cells have {', '.join(map(str, counts))}, expected the same number each")
    seeds = {row["seed"] for row in known if row["policy"] == GAIT and row["robot"] == content["robot"]}
    if seeds and content.get("seed") not in seeds:
        wanted = ", ".join(map(str, sorted(seeds)))
        yield Fault("seed", f"{content.get('seed')!r}, the table's flights have --seed {wanted}")


def _outcome_faults(cell: Mapping[str, Any]) -> Iterator[Fault]:
    outcomes, where = cell[OUTCOMES_KEY], _where(cell)
    arrived = outcomes.count("1")
    if set(outcomes) - {"0", "1"} or len(outcomes) != cell["episodes"]:
        expected = f"expected {cell['episodes']} of 0 and 1"
        yield Fault("outcomes", f"{where}: {len(outcomes)} outcomes of {sorted(set(outcomes))}, {expected}")
        return
    ends = cell["terminations"]
    claims = {
        "successes": (cell["successes"], arrived),
        "success_rate": (cell["success_rate"], arrived / max(len(outcomes), 1)),
        "terminations.success": (ends.get("success", 0), arrived),
        "sum of terminations": (sum(ends.values()), len(outcomes)),
    }
    for name, (said, follows) in claims.items():
        if not math.isclose(said, follows, abs_tol=TOLERANCE):
            yield Fault("outcomes", f"{where}: {name} is {said:g}, the outcomes give {follows:g}")
    interval = wilson_interval(arrived, len(outcomes))
    near = len(cell["ci95"]) == 2 and all(
        isinstance(said, (int, float)) and math.isclose(said, follows, abs_tol=TOLERANCE)
        for said, follows in zip(cell["ci95"], interval)
    )
    if not near:
        low, high = interval
        yield Fault("interval", f"{where}: ci95 is {cell['ci95']}, Wilson's is [{low:.6f}, {high:.6f}]")


def _overall_faults(content: Mapping[str, Any]) -> Iterator[Fault]:
    for source in dict.fromkeys(cell["source"] for cell in content["cells"]):
        said = content["overall"].get(source)
        for field in ("episodes", "successes"):
            total = sum(cell[field] for cell in content["cells"] if cell["source"] == source)
            if not isinstance(said, dict) or said.get(field) != total:
                given = said.get(field) if isinstance(said, dict) else None
                yield Fault("overall", f"{source}.{field} is {given}, the cells give {total}")
