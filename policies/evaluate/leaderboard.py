"""Policies on the ladder, side by side: rows of saved evaluations, and the page that shows them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from policies import pretrained
from policies.evaluate.evaluation import OUTCOMES_KEY, SOURCE_SETUPS, EvaluationConfig
from policies.evaluate.stair_sets import RUNG
from policies.rollout import CONTROLS
from policies.statistics import sign_test, wilson_interval
from stair_env.common.files import atomic_path
from stair_env.common.markdown import markdown_table

LADDER = "ladder"
GAIT = "zero"  # zero actions leave the gait to itself
ENTRY_FIELDS = ("policy", "robot", "source", "env_kwargs")  # what a line of the table stands for
CELL_FIELDS = ("direction", "condition", "riser_height", "tread_depth")
RUN_FIELDS = ("seed", "commit", "date")
SIGNIFICANT = 0.05
Row = dict[str, Any]
PAGE = """# Benchmark: the ladder

Written by `stair-env benchmark` from [benchmark.json](benchmark.json); nothing here is typed by hand.

Six steps; treads of 0.25-0.32 m, of 0.22-0.25 m where it is steep. On a rung, named by its riser, only the riser is
hard. `push_0.6` and `push_1.0`: the trunk's velocity changes by up to so many m/s along each axis, every 2 s or so.
`everything`: friction 0.5-1.1, payload, motors at 75-110 %, pushes of 0.6 m/s, a fifth of the commands late, steps
uneven by 15 mm. Heights depend on the length of the legs (`policies.evaluate.stair_sets`). Episode *i* of a cell is the
same flight for every line, so lines of one seed can be compared flight by flight.

`zero` is the gait alone, `random` draws every action. **Add a line of your own**:

```
stair-env evaluate --policy runs/mine/final --stairs ladder --episodes 30 --seed 41 --json mine.json
stair-env benchmark submit mine=mine.json           # checks the file, prints its line
stair-env benchmark submit mine=mine.json --write   # adds it to the table
```
"""


def plan(
    policies: Sequence[str] | None,
    sources: Sequence[str],
    directions: Sequence[str],
    episodes: int,
    seed: int,
    workers: int = 1,
) -> list[EvaluationConfig]:
    """What has to be flown.

    A policy that was trained without sight gets no stair block, whatever the sources. Names in CONTROLS fly every robot
    that another policy brings, on the oracle's block.

    Args:
        policies: names or paths; None takes all shipped ones and CONTROLS.
        sources: of the stair block of policies that see.
        directions, episodes, seed, workers: as in EvaluationConfig.

    Raises:
        ValueError: a policy is not there, or a wrong value.
    """
    names = list(policies) if policies is not None else [*pretrained.names(), *CONTROLS]
    trained = [name for name in names if name not in CONTROLS]
    robots = list(dict.fromkeys(pretrained.fitting_robot(None, [str(pretrained.locate(name))]) for name in trained))
    common: dict[str, Any] = {"stairs": LADDER, "directions": tuple(directions), "episodes": episodes, "seed": seed}
    common["workers"] = workers
    configs = []
    for name in trained:
        if pretrained.read_card(name).get("env_kwargs", {}).get("stair_source") == "blind":
            configs.append(EvaluationConfig(blind_policy=name, sources=("blind",), **common))
        else:
            configs.append(EvaluationConfig(policy=name, sources=tuple(sources), **common))
    for name in (name for name in names if name in CONTROLS):
        for robot in robots or [pretrained.fitting_robot(None)]:
            configs.append(EvaluationConfig(policy=name, robot=robot, sources=("oracle",), **common))
    return configs


def is_flown(config: EvaluationConfig, rows: Sequence[Row]) -> bool:
    """Whether rows hold all that an evaluation would bring, at the same seed and with as many episodes."""
    known = [row for row in rows if row["seed"] == config.seed and row["episodes"] >= config.episodes]
    policies = {"policy": config.policy, "blind": config.blind_policy}
    return all(
        any(
            row["policy"] == policies[SOURCE_SETUPS[source].actor]
            and (row["robot"], row["source"]) == (config.robot, source)
            and (row["direction"], row["condition"]) == (cell.direction, cell.condition)
            and json.dumps(row["riser_height"]) == json.dumps(cell.riser_height)
            for row in known
        )
        for source in config.sources
        for cell in config.cells()
    )


def read_rows(path: Path | str, name: str | None = None) -> list[Row]:
    """Rows of a results file of `stair-env evaluate --stairs ladder`, or of `stair-env benchmark`.

    Args:
        path: JSON file.
        name: of the policy in the table; None keeps what the file says.

    Raises:
        ValueError: the file is no such results file.
        FileNotFoundError: no such file.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not JSON: {error}") from None
    if not isinstance(content, dict) or content.get("stairs") != LADDER or not isinstance(content.get("cells"), list):
        raise ValueError(f"{path} is no results file of `stair-env evaluate --stairs ladder`")
    return rows_of(content, name)


def rows_of(results: Mapping[str, Any], name: str | None = None) -> list[Row]:
    """A row for each cell of an evaluation on the ladder, with policy, robot, seed and commit."""
    actors = {"policy": results.get("policy"), "blind": results.get("blind_policy"), "gait": GAIT}
    common = {"robot": results.get("robot"), **{field: results.get(field) for field in RUN_FIELDS}}
    if results.get("env_kwargs"):
        common["env_kwargs"] = results["env_kwargs"]
    rows = []
    for cell in results["cells"]:
        row = {"policy": actors[SOURCE_SETUPS[cell["source"]].actor], **common, **cell}
        if row["source"] == "gait":
            row["source"] = "oracle"
        if name is not None and row["policy"] not in CONTROLS:
            row["policy"] = name
        rows.append(row)
    return rows


def merge(*tables: Iterable[Row]) -> list[Row]:
    """Rows of several tables; of two about the same policy, robot, source and cell the later one counts."""
    merged: dict[str, Row] = {}
    for table in tables:
        for row in table:
            merged[_key(row, (*ENTRY_FIELDS, *CELL_FIELDS))] = row
    return list(merged.values())


def _key(row: Row, fields: Sequence[str]) -> str:
    """Some fields of a row as one word; JSON knows no difference between a tuple and a list."""
    return json.dumps([row.get(field) for field in fields], sort_keys=True)


def write_page(rows: Sequence[Row], path: Path | str, figure: str | None = None) -> None:
    """Write the page.

    Args:
        rows: of `rows_of` or `merge`.
        path: Markdown file.
        figure: name of the picture beside it.
    """
    parts = [PAGE]
    if figure:
        parts.append(f"![Success over the ladder]({figure})\n")
    for robot in dict.fromkeys(row["robot"] for row in rows):
        parts.append(f"## {robot}\n\n{summary_table([row for row in rows if row['robot'] == robot])}")
        parts.append(_details([row for row in rows if row["robot"] == robot]))
    parts.append("## Where the lines come from\n\n" + markdown_table(_origins(rows)))
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(parts), encoding="utf-8")


def summary_table(rows: Sequence[Row]) -> str:
    """A line for each policy and source, best first: success over all, and by rung and condition, up and down together.

    Args:
        rows: of one robot.
    """
    columns = list(dict.fromkeys(map(column_of, rows)))
    entries = sorted(_entries(rows).values(), key=lambda entry: -_share(entry))
    gait = next((entry for entry in entries if _is_gait(entry[0])), [])
    lines = []
    for entry in entries:
        line = {"policy": label(entry[0]), "source": entry[0]["source"], "all": _with_interval(entry)}
        gained, lost = _against(entry, gait)
        line["against the gait"] = "" if entry is gait or not gait else f"+{gained} -{lost} ({_p_value(gained, lost)})"
        for column in columns:
            line[column] = _percent([row for row in entry if column_of(row) == column])
        lines.append(line)
    return markdown_table(lines)


def _details(rows: Sequence[Row]) -> str:
    """Each cell with its interval, and whether it differs from the gait by more than chance."""
    columns = list(dict.fromkeys(map(column_of, rows)))
    entries = list(_entries(rows).values())
    gait = next((entry for entry in entries if _is_gait(entry[0])), [])
    lines = []
    for entry in sorted(entries, key=lambda entry: -_share(entry)):
        for direction in dict.fromkeys(row["direction"] for row in entry):
            line = {"policy": label(entry[0]), "source": entry[0]["source"], "": direction}
            for column in columns:
                part = [row for row in entry if (row["direction"], column_of(row)) == (direction, column)]
                line[column] = _with_interval(part) + _mark(part, gait) if part else ""
            lines.append(line)
    note = "Per cent with 95 % intervals; ▲ and ▼: above or below the gait on the same flights (sign test, 5 %).\n"
    return f"{note}\n{markdown_table(lines)}"


def _entries(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows by what a line of the table stands for."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(_key(row, ENTRY_FIELDS), []).append(row)
    return found


def label(row: Row) -> str:
    """A policy's name, with the arguments of the environment where there are any."""
    return f"{row['policy']} {json.dumps(row['env_kwargs'])}" if row.get("env_kwargs") else str(row["policy"])


def column_of(row: Row) -> str:
    """Name of a cell without its direction."""
    return f"{row['riser_height']:.2f} m" if row["condition"] == RUNG else str(row["condition"])


def _is_gait(row: Row) -> bool:
    return row["policy"] == GAIT and row["source"] == "oracle" and not row.get("env_kwargs")


def _totals(rows: Sequence[Row]) -> tuple[int, int]:
    return sum(row["successes"] for row in rows), sum(row["episodes"] for row in rows)


def _share(rows: Sequence[Row]) -> float:
    successes, episodes = _totals(rows)
    return successes / max(episodes, 1)


def _percent(rows: Sequence[Row]) -> str:
    return f"{_share(rows):.0%}" if rows else ""


def _with_interval(rows: Sequence[Row]) -> str:
    low, high = wilson_interval(*_totals(rows))
    return f"{_share(rows):.0%} ({100 * low:.0f}-{100 * high:.0f})"


def _against(rows: Sequence[Row], gait: Sequence[Row]) -> tuple[int, int]:
    """Flights that arrive and those of the gait do not, and the other way round; of one seed only."""
    gained = lost = 0
    partners = {(_key(row, CELL_FIELDS), row["seed"]): row for row in gait}
    for row in rows:
        partner = partners.get((_key(row, CELL_FIELDS), row["seed"]), {})
        for own, other in zip(row.get(OUTCOMES_KEY, ""), partner.get(OUTCOMES_KEY, "")):
            gained += own > other
            lost += own < other
    return gained, lost


def _p_value(gained: int, lost: int) -> str:
    p = sign_test(gained, lost)
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}"


def _mark(rows: Sequence[Row], gait: Sequence[Row]) -> str:
    gained, lost = _against(rows, gait)
    if sign_test(gained, lost) >= SIGNIFICANT:
        return ""
    return " ▲" if gained > lost else " ▼"


def _origins(rows: Sequence[Row]) -> list[Row]:
    """Seed, commit and date of each line."""
    lines = []
    for entry in _entries(rows).values():
        first = entry[0]
        counts = sorted({row["episodes"] for row in entry})
        flights = "-".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
        commits = dict.fromkeys(_brief(str(row.get("commit"))) for row in entry)
        line = {"policy": label(first), "robot": first["robot"], "source": first["source"], "flights a cell": flights}
        lines.append({**line, "seed": first["seed"], "commit": ", ".join(commits), "date": first.get("date")})
    return lines


def _brief(commit: str) -> str:
    """A commit's first digits, and whether files differed from it."""
    digits, dash, changed = commit.partition("-")
    return digits[:12] + dash + changed
