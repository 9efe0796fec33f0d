"""Learning curves on disk, and those of several runs side by side.

`python -m policies.train.curves RUN... --output results/curves.json` writes a table, the curves, and a picture beside
it: of several seeds of one training, or with NAME=RUN of trainings that differ in anything.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from policies.statistics import wilson_interval
from stair_env.common.files import read_json_object

CURVE_FILE = "curve.csv"
CONFIG_FILE = "config.json"
LOGGED = ("approx_kl", "explained_variance", "value_loss", "std", "ent_coef")  # SB3's names; each algorithm has some
CURVE_FIELDS = (
    "timesteps",
    "wall_s",
    "episodes",
    "return_mean",
    "length_mean",
    "success_rate",
    "level_mean",
    *LOGGED,
)
COMPARED = ("timesteps", "return_mean", "success_rate", "level_mean")
ALONE_FIELDS = ("timesteps", "loss", "alone_episodes", "alone_successes", "wall_s")  # of policies.train.imitation
WINDOW = 3  # of its rounds, in which flights are counted together: one holds some fifteen
SHARED = ("algorithm", "env_id", "env_kwargs", "hyperparams", "total_timesteps", "num_envs")


def read_curve(path: Path | str) -> list[dict[str, Any]]:
    """Rows of a learning curve, numbers as floats and missing values as ""; no file, no rows."""
    if not Path(path).is_file():
        return []
    with Path(path).open(newline="", encoding="utf-8") as file:
        return [
            {name: float(value) if value not in ("", None) else "" for name, value in row.items()}
            for row in csv.DictReader(file)
        ]


def add_rates(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return ALONE_FIELDS of a curve's rows, and the share of the flights alone that arrived.

    Args:
        rows: a row a round of learning from a teacher.

    Returns:
        Rows with `alone_rate` and `alone_ci95` too, of this round and the WINDOW - 1 before it; None without flights.
    """
    read = []
    for end, row in enumerate(rows, 1):
        recent = rows[max(end - WINDOW, 0) : end]
        flown, arrived = (int(sum(one[field] for one in recent)) for field in ("alone_episodes", "alone_successes"))
        rate = {"alone_rate": arrived / flown, "alone_ci95": list(wilson_interval(arrived, flown))} if flown else {}
        read.append({**{field: row[field] for field in ALONE_FIELDS}, "alone_rate": None, "alone_ci95": None, **rate})
    return read


def compare_runs(runs: Iterable[Path | str] | Mapping[str, Path | str]) -> dict[str, Any]:
    """What several seeds of one training did, or several trainings.

    Args:
        runs: folders that `stair-env train` wrote; by name when they differ in more than the seed.

    Returns:
        JSON-able: `rows` (a table of beginnings and ends), `curves` (COMPARED of each run), and the settings that the
        runs share; of runs by name each row has its own settings.

    Raises:
        ValueError: a folder is no run, or runs without names differ in more than their seed.
    """
    rows, curves, settings = [], [], None
    named = dict(runs) if isinstance(runs, Mapping) else {}
    for name, run in named.items() if named else ((None, run) for run in runs):
        run = Path(run)
        curve = read_curve(run / CURVE_FILE)
        if not curve or not (run / CONFIG_FILE).is_file():
            raise ValueError(f"{run} holds no {CURVE_FILE} with rows beside a {CONFIG_FILE}")
        config = read_json_object(run / CONFIG_FILE)
        shared = {setting: config.get(setting) for setting in SHARED}
        if not named and settings not in (None, shared):
            raise ValueError(f"{run} differs from the runs before it in more than the seed; name them: NAME=RUN")
        own = {"name": name, "seed": config["seed"]} if named else {"seed": config["seed"]}
        settings = {} if named else shared
        kept = {"env_id": shared["env_id"], "env_kwargs": json.dumps(shared["env_kwargs"])} if named else {}
        rows.append({**own, **kept, "commit": config.get("commit", "")[:12], **_ends(curve)})
        curves.append({**own, **{field: [row[field] for row in curve] for field in COMPARED}})
    if settings is None:
        raise ValueError("runs is empty")
    return {"rows": rows, "curves": curves, **settings}


def _ends(curve: list[dict[str, Any]]) -> Mapping[str, Any]:
    """First and last value of each figure, and the steps between."""
    first, last = curve[0], curve[-1]
    values = {"timesteps": last["timesteps"], "wall_s": last["wall_s"]}
    for name in COMPARED[1:]:
        values |= {f"{name}_first": first[name], f"{name}_last": last[name]}
    return values


def _main() -> None:
    import argparse

    from policies.report.figures import draw_curves
    from stair_env.common.files import write_json

    parser = argparse.ArgumentParser(
        prog="python -m policies.train.curves", description="Learning curves side by side."
    )
    parser.add_argument(
        "runs", nargs="+", metavar="RUN", help="folder of a run; NAME=RUN where more than the seed differs"
    )
    parser.add_argument("--output", type=Path, required=True, help="JSON file; the picture lies beside it")
    args = parser.parse_args()
    named = {name: Path(run) for name, found, run in (text.rpartition("=") for text in args.runs) if found}
    if named and len(named) < len(args.runs):
        parser.error("name every run, each otherwise, or none")
    runs = named or {Path(run).name: Path(run) for run in args.runs}
    try:
        results = compare_runs(named or args.runs)
    except ValueError as error:
        parser.error(str(error))
    draw_curves({name: read_curve(run / CURVE_FILE) for name, run in runs.items()}, args.output.with_suffix(".png"))
    write_json(args.output, results)
    print(args.output)


if __name__ == "__main__":
    _main()
