"""`stair-env benchmark`: all policies on the ladder, in one table that takes rows of one's own."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from stair_env.common.constants import EVALUATION_SOURCES, WALKING_DIRECTIONS
from stair_env_cli.arguments import add_common_arguments, choice_list, limit_threads, positive_int, write_json

RESULTS_FILE, PAGE_FILE, FIGURE_FILE = "benchmark.json", "benchmark.md", "benchmark.png"
SUBMIT = "submit"  # a first word that is no file
SEEING_SOURCES = tuple(name for name in EVALUATION_SOURCES if name not in ("blind", "gait"))


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Declare the options."""
    parser = subparsers.add_parser(
        "benchmark",
        help="all policies on the ladder, in one table that takes rows of one's own",
        description="Fly policies over the ladder (`evaluate --stairs ladder`) and write benchmark.json, .md and .png. "
        "Lines that are there already stay, unless they are flown again. `benchmark submit [NAME=]FILE` checks a "
        "results file of one's own and prints its line; with --write the line joins the table.",
    )
    parser.add_argument(
        "files",
        nargs="*",
        metavar="[submit] [NAME=]FILE",
        help="results of `evaluate --stairs ladder --json` to merge, their policy called NAME; nothing is flown unless "
        "--policy says so",
    )
    parser.add_argument(
        "--policy",
        type=lambda text: tuple(filter(None, text.split(","))),
        metavar="LIST",
        help="comma-separated names or folders to fly, also zero (the gait alone) and random (all shipped, and these)",
    )
    parser.add_argument(
        "--source",
        type=choice_list(SEEING_SOURCES),
        default=("oracle",),
        metavar="LIST",
        help=f"of policies that see: {', '.join(SEEING_SOURCES)} (oracle)",
    )
    parser.add_argument(
        "--direction",
        type=choice_list(WALKING_DIRECTIONS),
        default=WALKING_DIRECTIONS,
        metavar="LIST",
        help="(up,down)",
    )
    parser.add_argument("--episodes", type=positive_int, default=30, help="of each cell (%(default)s)")
    parser.add_argument("--workers", type=positive_int, default=os.cpu_count() or 1, help="processes (%(default)s)")
    parser.add_argument("--output", type=Path, default=Path("results"), help="folder (%(default)s)")
    parser.add_argument(
        "--resume", action="store_true", help="leave out what the table has with this seed and as many episodes"
    )
    parser.add_argument("--write", action="store_true", help="of submit: add the line to the table in --output")
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Fly, merge, write."""
    if args.files and args.files[0] == SUBMIT:
        return _submit(args)
    if args.write:
        raise ValueError("--write is for `benchmark submit`")
    limit_threads(1)
    from policies.evaluate import evaluation
    from policies.evaluate import leaderboard as board
    from stair_env.common.files import provenance
    from stair_env.common.progress import progress_bar

    known = args.output / RESULTS_FILE
    rows = board.read_rows(known) if known.is_file() else []
    for text in args.files:
        name, _, path = text.rpartition("=")
        rows = board.merge(rows, board.read_rows(path, name or None))
    configs = []
    if args.policy or not args.files:
        configs = board.plan(args.policy, args.source, args.direction, args.episodes, args.seed, args.workers)
    if args.resume:
        configs = [config for config in configs if not board.is_flown(config, rows)]
    with progress_bar(sum(map(evaluation.count_episodes, configs)), "benchmark", unit="episode") as bar:
        for config in configs:
            settings = {name: getattr(config, name) for name in ("robot", "policy", "blind_policy")}
            results = {**settings, **evaluation.evaluate(config, bar.update), **provenance(args.seed)}
            rows = board.merge(rows, board.rows_of(results))
            _write(rows, args)  # after each policy: a kill costs one
    _write(rows, args)
    for robot in dict.fromkeys(row["robot"] for row in rows):
        print(f"{robot}\n\n{board.summary_table([row for row in rows if row['robot'] == robot])}")
    print(f"page: {args.output / PAGE_FILE}")
    return 0


def _submit(args: argparse.Namespace) -> int:
    """Check a results file, print its line, and with --write let it join the table."""
    from policies.evaluate import leaderboard as board
    from policies.evaluate.submission import read_submission

    if len(args.files) != 2:
        raise ValueError("benchmark submit takes one results file: submit [NAME=]FILE")
    name, _, path = args.files[1].rpartition("=")
    known = args.output / RESULTS_FILE
    rows = read_submission(path, name or None, known)
    print(f"{path}: no fault found; its line:\n\n{board.summary_table(_beside_the_gait(rows, known))}")
    if args.write:
        _write(board.merge(board.read_rows(known) if known.is_file() else [], rows), args)
        print(f"page: {args.output / PAGE_FILE}")
    elif args.json:
        write_json(args.json, {"stairs": board.LADDER, "cells": rows}, seed=rows[0]["seed"])
    return 0


def _beside_the_gait(rows: list[dict[str, Any]], known: Path) -> list[dict[str, Any]]:
    """Rows of a submission, and the gait's of the same robot, which they are compared with."""
    from policies.evaluate import leaderboard as board

    table = board.read_rows(known) if known.is_file() else []
    return [*rows, *(row for row in table if row["policy"] == board.GAIT and row["robot"] == rows[0]["robot"])]


def _write(rows: list[dict[str, Any]], args: argparse.Namespace) -> None:
    from policies.evaluate.leaderboard import LADDER, write_page
    from policies.report.figures import draw_ladder

    results = {"stairs": LADDER, "cells": rows}
    write_json(args.output / RESULTS_FILE, results, seed=args.seed)
    if args.json:
        write_json(args.json, results, seed=args.seed)
    draw_ladder(rows, args.output / FIGURE_FILE)
    write_page(rows, args.output / PAGE_FILE, FIGURE_FILE)
