"""Bullet and MuJoCo side by side: `python -m policies.evaluate.sim_to_sim OUT.json RESULTS.json ...`.

Pairs results of `stair-env evaluate` (and rows of `stair-env benchmark`) that differ in nothing but the engine: the
same policy on the same staircases, seed for seed.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from policies.evaluate.evaluation import OUTCOMES_KEY
from policies.evaluate.leaderboard import GAIT, rows_of
from policies.evaluate.stair_sets import RUNG
from policies.statistics import sign_test, wilson_interval
from stair_env.common.constants import PHYSICS_ENGINES
from stair_env.common.files import write_json

BULLET, MUJOCO = PHYSICS_ENGINES
GAIT_NAME = "gait alone"
CELL_FIELDS = ("direction", "stair", "condition", "riser_height", "tread_depth", "num_steps")
Row = dict[str, Any]


def read_cells(path: Path | str) -> list[Row]:
    """Cells of a results file, each with policy, robot, seed and engine.

    Raises:
        ValueError: the file is no results file, or of before outcomes were kept.
        FileNotFoundError: no such file.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not JSON: {error}") from None
    if not isinstance(content, dict) or not isinstance(content.get("cells"), list):
        raise ValueError(f"{path} is no results file of `stair-env evaluate`")
    cells = []
    for row in rows_of(content):
        if OUTCOMES_KEY not in row:
            raise ValueError(f"{path} does not say how each flight went ({OUTCOMES_KEY!r} is missing): fly it again")
        others = {name: value for name, value in (row.get("env_kwargs") or {}).items() if name != "engine"}
        engine = (row.get("env_kwargs") or {}).get("engine", BULLET)
        cells.append({**row, "engine": engine, "others": others, "set": content.get("stairs")})
    return cells


def compare(cells: Iterable[Mapping[str, Any]]) -> list[Row]:
    """A row for each policy, set of stairs and direction that both engines have flown.

    Of the flights of a cell as many count as both have. The paper's six stairs count together, each cell of the ladder
    by itself.

    Args:
        cells: of `read_cells`.

    Returns:
        Successes and Wilson's 95 % interval by engine; `lost` are flights that arrive in Bullet and not in MuJoCo,
        `gained` the other way round, and `p` is the sign test's between them.
    """
    flown: dict[str, dict[str, str]] = {}
    named: dict[str, Row] = {}
    for cell in cells:
        key = json.dumps([_policy(cell), *(cell.get(name) for name in ("robot", "source", "seed", "others"))])
        key += json.dumps([cell.get(name) for name in CELL_FIELDS])
        flown.setdefault(key, {})[cell["engine"]] = cell[OUTCOMES_KEY]
        named[key] = {"policy": _policy(cell), "robot": cell["robot"], "stairs": _stairs(cell)}
        named[key] |= {"direction": cell["direction"], "seed": cell["seed"]}
    together: dict[str, tuple[Row, list[tuple[str, str]]]] = {}
    for key, outcomes in flown.items():
        if {BULLET, MUJOCO} <= set(outcomes):
            count = min(len(outcomes[BULLET]), len(outcomes[MUJOCO]))
            pairs = list(zip(outcomes[BULLET][:count], outcomes[MUJOCO][:count]))
            together.setdefault(json.dumps(named[key]), (named[key], []))[1].extend(pairs)
    return [_row(names, pairs) for names, pairs in together.values()]


def _policy(cell: Mapping[str, Any]) -> str:
    return GAIT_NAME if cell["policy"] == GAIT else str(cell["policy"])


def _stairs(cell: Mapping[str, Any]) -> str:
    if cell.get("condition") == RUNG:
        return f"riser {cell['riser_height']:.2f} m"
    return str(cell.get("condition") or cell.get("set"))


def _row(names: Row, pairs: list[tuple[str, str]]) -> Row:
    counts = {engine: sum(pair[k] == "1" for pair in pairs) for k, engine in enumerate(PHYSICS_ENGINES)}
    row = {**names, "episodes": len(pairs)}
    for engine, successes in counts.items():
        row |= {engine: successes, f"{engine}_ci95": list(wilson_interval(successes, len(pairs)))}
    lost, gained = pairs.count(("1", "0")), pairs.count(("0", "1"))
    return {**row, "lost": lost, "gained": gained, "p": sign_test(gained, lost)}


def main(arguments: list[str] | None = None) -> int:
    """Write the table."""
    parser = argparse.ArgumentParser(prog="python -m policies.evaluate.sim_to_sim", description=__doc__)
    parser.add_argument("output", type=Path)
    parser.add_argument("results", type=Path, nargs="+")
    args = parser.parse_args(arguments)
    rows = compare(cell for path in args.results for cell in read_cells(path))
    if not rows:
        parser.error("no cell was flown in both engines with one policy and one seed")
    write_json(args.output, {"rows": rows}, seed=rows[0]["seed"])
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
