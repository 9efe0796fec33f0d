"""`stair-env measure`: the paper's table 7 on simulated D435i frames, or the same stairs seen by a walking robot."""

from __future__ import annotations

import argparse
from typing import Any

from stair_env.common.constants import (
    DEPTH_SOURCES,
    MEASURED_DETECTORS,
    NETWORK_WIDTHS,
    PAPER_STAIR_NAMES,
    WALK_DRIVERS,
)
from stair_env_cli.arguments import (
    add_backend_argument,
    add_common_arguments,
    choice_list,
    limit_threads,
    positive_int,
    progress_bar,
    write_json,
)


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "measure",
        help="errors of step width and height on the paper's six stairs",
        description="Errors of step width and height on the paper's six stairs: in single frames (table 7), or with "
        "--walking in what the tracker makes of them while a robot walks over whole flights.",
    )
    parser.add_argument(
        "--network", choices=MEASURED_DETECTORS, default="stairnet", help="ideal: true lines, the floor of the geometry"
    )
    parser.add_argument("--width", type=float, choices=NETWORK_WIDTHS, default=0.5, help="of StairNetV2 (%(default)s)")
    add_backend_argument(parser)
    parser.add_argument(
        "--poses", type=positive_int, default=50, help="camera poses per staircase, direction and light (%(default)s)"
    )
    parser.add_argument(
        "--stairs", type=choice_list(PAPER_STAIR_NAMES), default=PAPER_STAIR_NAMES, help="comma-separated (all)"
    )
    parser.add_argument("--mode", default="640x480", help="D435i colour mode (%(default)s)")
    parser.add_argument(
        "--depth",
        choices=DEPTH_SOURCES,
        default="model",
        help="of single frames: a fast error model, or matched infrared pairs",
    )
    walking = parser.add_argument_group("walking")
    walking.add_argument("--walking", action="store_true", help="walk over the stairs instead of taking single frames")
    walking.add_argument(
        "--drivers",
        type=choice_list(WALK_DRIVERS),
        default=WALK_DRIVERS,
        help="stairs that the gait reads, comma-separated (both)",
    )
    walking.add_argument(
        "--flights", type=positive_int, default=4, help="walks per staircase, direction and driver (%(default)s)"
    )
    walking.add_argument("--robot", default="aliengo", help="which walks (%(default)s)")
    walking.add_argument("--workers", type=positive_int, default=1, help="processes that walk (%(default)s)")
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print the table, write the JSON."""
    return _run_walks(args) if args.walking else _run_frames(args)


def _run_walks(args: argparse.Namespace) -> int:
    limit_threads(1)
    from perception.reproduction.walking import LiveConfig, run_walks
    from stair_env.scene.paper_stairs import PAPER_STAIRS

    if args.network != "stairnet":
        raise ValueError(f"--network {args.network} takes single frames; --walking needs stairnet")
    stairs = tuple(stair for stair in PAPER_STAIRS if stair.name in args.stairs)
    config = LiveConfig(args.drivers, args.flights, args.width, args.backend, args.robot, stairs, args.workers)
    with progress_bar(config.walks, "measure", unit="flight") as bar:
        result = run_walks(config, args.seed, bar.update)
    if args.json is not None:
        write_json(args.json, result, seed=args.seed)
    print(f"{'':<34}{'width':>8}{'height':>8}{'next edge':>11}{'valid':>9}{'flights':>9}")
    for name, row in result["overall"].items():
        errors = (row[f"{error}_rmse_mm"] for error in ("width", "height", "next_edge"))
        cells = ["-" if error is None else f"{error:.1f}" for error in errors]
        print(f"{name:<34}{cells[0]:>8}{cells[1]:>8}{cells[2]:>11}{row['valid']:>9.1%}{row['flights']:>9}")
    print("Root mean square errors in mm; valid: share of the time from 1.5 m before the first step on.")
    return 0


def _run_frames(args: argparse.Namespace) -> int:
    from tqdm import tqdm

    from perception.reproduction.table7_geometry import MeasureConfig, run_measurement
    from stair_env.scene.paper_stairs import PAPER_STAIRS

    stairs = tuple(stair for stair in PAPER_STAIRS if stair.name in args.stairs)
    config = MeasureConfig(args.network, args.width, args.poses, args.mode, stairs, args.backend, args.depth)
    with tqdm(total=config.frames, desc="measure", unit="frame", dynamic_ncols=True) as bar:
        result = run_measurement(config, args.seed, bar.update)
    if args.json is not None:
        write_json(args.json, result, seed=args.seed)
    _print_table(result)
    return 0


def _print_table(result: dict[str, Any]) -> None:
    print(f"{'stair':8}{'step':>5}  {'direction':12}{'true':>12}{'measured':>18}{'std':>14}{'n':>6}{'paper fit':>18}")
    for row in result["rows"]:
        print(
            f"{row['stair']:8}{row['step']:>5}  {row['direction']:12}{_pair(row['true_mm'], 0):>12}"
            f"{_pair(row['measured_mm']):>18}{_pair(row['std_mm']):>14}{row['frames']:>6}{_pair(row['paper_fit_mm']):>18}"
        )
    print("\nRoot mean square errors (width, height) in mm over all single frames, and share of steps measured:")
    for method, cases in result["rmse_mm_by"].items():
        for case, numbers in cases.items():
            print(f"  {method:26}{case:20}{_pair(numbers['rmse_mm']):>18}{100 * numbers['coverage']:>8.1f} %")


def _pair(values: list[float] | None, digits: int = 1) -> str:
    return "-" if values is None else f"({values[0]:.{digits}f}, {values[1]:.{digits}f})"
