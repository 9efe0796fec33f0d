"""`stair-env bench`: ratios, each pair timed in the same run, interleaved."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from stair_env_cli.arguments import (
    add_backend_argument,
    add_common_arguments,
    add_engine_arguments,
    choice_list,
    count_list,
    limit_threads,
    positive_int,
    progress,
    write_json,
)
from stair_env_cli.bench.timing import Row

ROUNDS = 15
NAMES = (
    "env-step",
    "vector-step",
    "camera-frame",
    "worker-memory",
    "network-0.25",
    "network-1",
    "after-network",
    "perceived-frame",
    "perceived-frame-walking",
    "batch",
    "training-0.25",
    "training-0.5",
    "deploy-body",
    "deploy-network",
    "deploy-geometry",
    "deploy-tracker",
    "deploy-policy",
    "deploy-gait",
)


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Declare the options."""
    parser = subparsers.add_parser(
        "bench",
        help="time and memory ratios, each pair measured in one run",
        description="Measure pairs in turn. A ratio is theirs over ours: above 1, ours is faster or smaller.",
    )
    parser.add_argument("--rounds", type=positive_int, help=f"pairs to measure ({ROUNDS})")
    parser.add_argument(
        "--only", type=choice_list(NAMES), default=NAMES, metavar="LIST", help=f"of {', '.join(NAMES)} (all)"
    )
    parser.add_argument(
        "--scale",
        type=count_list,
        metavar="LIST",
        help="instead of all that: flights on so many workers against one, comma-separated (3 rounds)",
    )
    add_engine_arguments(parser)
    add_backend_argument(parser)
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Measure and print a table."""
    rows = _scale(args) if args.scale else _pairs(args)
    if args.json:
        write_json(args.json, {"rows": [row.to_dict() for row in rows]}, seed=args.seed)
    print(f"{'':<64}{'ours':>10}{'theirs':>10}{'':>4}{'ratio':>8}{'wanted':>8}")
    for row in rows:
        wanted = "" if row.target is None else f">={row.target:g}"
        print(f"{row.name:<64}{row.ours:>10.3f}{row.theirs:>10.3f}{row.unit:>4}{row.ratio:>8.2f}{wanted:>8}")
    return 0


def _pairs(args: argparse.Namespace) -> list[Row]:
    if args.engine != "local" or args.ray_address:
        raise ValueError(f"--engine {args.engine} is for --scale")
    measures = all_rows(args.backend)
    return [measures[name](args.rounds or ROUNDS) for name in progress(args.only, description="bench")]


def _scale(args: argparse.Namespace) -> list[Row]:
    limit_threads(1)
    from stair_env_cli.bench import scale_rows

    rounds = args.rounds or scale_rows.ROUNDS
    return scale_rows.scale_rows(args.scale, args.engine, args.ray_address, rounds)


def all_rows(backend: str = "onnx") -> dict[str, Callable[[int], Row]]:
    """Every comparison by name: a function of the number of rounds.

    Args:
        backend: that runs the network, where there is one.
    """
    from stair_env_cli.bench import deploy_rows, env_rows, perception_rows

    def bound(row: Callable[[int, str], Row]) -> Callable[[int], Row]:
        return lambda rounds: row(rounds, backend)

    networked = {**perception_rows.ROWS, **deploy_rows.ROWS}
    return {**env_rows.ROWS, **{name: bound(row) for name, row in networked.items()}}
