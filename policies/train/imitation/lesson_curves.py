"""Curves of several runs of learning from a teacher, side by side.

`python -m policies.train.imitation.lesson_curves NAME=RUN... --output FILE.json --figure FILE.png` writes both.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from policies.train.curves import ALONE_FIELDS, CURVE_FILE, WINDOW, add_rates, read_curve
from stair_env.common.files import read_json_object


def read_runs(runs: Mapping[str, Path | str]) -> dict[str, list[dict[str, Any]]]:
    """Rows of each run's curve.

    Args:
        runs: folders that `stair-env train --teacher` wrote, by the name that they get.

    Returns:
        By name, a row a round: ALONE_FIELDS, and `alone_rate` with `alone_ci95`: the share of the flights alone that
        arrived in this round and the WINDOW - 1 before it; None where there were none.

    Raises:
        ValueError: a folder holds no curve of this kind.
    """
    return {name: _read_run(Path(run)) for name, run in runs.items()}


def read_table(path: Path | str) -> dict[str, list[dict[str, Any]]]:
    """What `read_runs` gave to an earlier output of this command, whose runs need not be there any more.

    Raises:
        ValueError: the file is no such output.
    """
    try:
        table = read_json_object(path)["curves"]
        columns = {curve["run"]: {key: values for key, values in curve.items() if key != "run"} for curve in table}
        return {name: [dict(zip(of, row)) for row in zip(*of.values(), strict=True)] for name, of in columns.items()}
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{path} is no output of policies.train.imitation.lesson_curves: {error}") from None


def _read_run(run: Path) -> list[dict[str, Any]]:
    rows = read_curve(run / CURVE_FILE)
    if not rows or any(field not in rows[0] for field in ALONE_FIELDS):
        raise ValueError(f"{run} holds no {CURVE_FILE} with {', '.join(ALONE_FIELDS)}")
    return add_rates(rows)


def _named(text: str) -> tuple[str, Path]:
    name, _, folder = text.rpartition("=")
    return name or Path(folder).name, Path(folder)


def _main() -> None:
    import argparse

    from policies.report.figures import draw_imitation
    from stair_env.common.files import write_json

    parser = argparse.ArgumentParser(
        prog="python -m policies.train.imitation.lesson_curves",
        description="Curves of runs that learned from a teacher.",
    )
    parser.add_argument("runs", nargs="+", type=_named, metavar="[NAME=]RUN")
    parser.add_argument("--beside", type=Path, metavar="FILE", help="an earlier output, whose curves stay")
    parser.add_argument("--output", type=Path, required=True, help="JSON file")
    parser.add_argument("--figure", type=Path, required=True, help="PNG file")
    args = parser.parse_args()
    try:
        curves = {**(read_table(args.beside) if args.beside else {}), **read_runs(dict(args.runs))}
    except (ValueError, OSError) as error:
        parser.error(str(error))
    draw_imitation(curves, args.figure)
    ends = [{"run": name, **rows[-1]} for name, rows in curves.items()]
    table = [{"run": name, **{key: [row[key] for row in rows] for key in rows[0]}} for name, rows in curves.items()]
    write_json(args.output, {"window": WINDOW, "rows": ends, "curves": table})
    print(args.output, args.figure)


if __name__ == "__main__":
    _main()
