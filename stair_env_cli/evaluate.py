"""`stair-env evaluate`: the same episodes with different stair sources, side by side."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from stair_env.common.constants import EVALUATION_SOURCES, LIGHTING_CHOICES, STAIR_SETS, WALKING_DIRECTIONS
from stair_env_cli.arguments import (
    add_common_arguments,
    add_engine_arguments,
    add_network_server_argument,
    add_physics_argument,
    choice_list,
    json_object,
    limit_threads,
    number_list,
    physics_kwargs,
    positive_int,
    write_json,
)

SETTINGS = ("robot", "stairs", "lighting", "env_kwargs", "policy", "blind_policy")


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Declare the options."""
    parser = subparsers.add_parser(
        "evaluate",
        help="compare stair sources on paired episodes",
        description="Run the same episodes with each source of the stair block; 95 % intervals are Wilson's.",
    )
    parser.add_argument(
        "--policy",
        metavar="NAME|FILE",
        help="shipped name, folder or model.zip; or zero (the gait alone), random (the robot's name)",
    )
    parser.add_argument(
        "--blind-policy", metavar="NAME|FILE", help="policy of the source `blind`, trained without sight (POLICY-blind)"
    )
    parser.add_argument("--robot", metavar="NAME", help="robot (the policy's, or aliengo)")
    parser.add_argument(
        "--source",
        type=choice_list(EVALUATION_SOURCES),
        default=("oracle", "gait"),
        metavar="LIST",
        help=f"comma-separated: {', '.join(EVALUATION_SOURCES)} (oracle,gait)",
    )
    parser.add_argument(
        "--stairs",
        choices=STAIR_SETS,
        default="paper",
        help="the six of the paper's table 7, risers x treads, random, or a ladder beyond the gait (%(default)s)",
    )
    parser.add_argument(
        "--direction",
        type=choice_list(WALKING_DIRECTIONS),
        default=WALKING_DIRECTIONS,
        metavar="LIST",
        help="up, down (both)",
    )
    parser.add_argument(
        "--risers", type=number_list, metavar="LIST", help="of the grid, metres, comma-separated (0.08,0.11,0.14,0.17)"
    )
    parser.add_argument("--treads", type=number_list, metavar="LIST", help="likewise (0.25,0.30,0.35)")
    parser.add_argument("--episodes", type=positive_int, default=10, help="of each cell and source (%(default)s)")
    parser.add_argument("--lighting", choices=LIGHTING_CHOICES, default="day", help="(%(default)s)")
    parser.add_argument(
        "--env-kwargs", type=json_object, default={}, metavar="JSON", help="further arguments of the environments"
    )
    add_physics_argument(parser)
    parser.add_argument("--workers", type=positive_int, default=os.cpu_count() or 1, help="processes (%(default)s)")
    add_engine_arguments(parser)
    add_network_server_argument(parser)
    parser.add_argument(
        "--figure", type=Path, metavar="FILE", help="draw success over risers and treads, or the ladder, as PNG"
    )
    parser.add_argument(
        "--film", type=Path, metavar="FOLDER", help="film the first failure and the first success of each source"
    )
    parser.add_argument("--rerun", type=Path, metavar="FOLDER", help="the same episodes for the Rerun viewer (.rrd)")
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on with the episodes that were written beside --json (FILE.episodes.jsonl) before a kill, or with "
        "fewer episodes or sources",
    )
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Evaluate, print a table, write JSON and figure."""
    limit_threads(1)
    from stair_env.common.files import takes_files_beside

    if args.resume and not (args.json and takes_files_beside(args.json)):
        raise ValueError("--resume needs --json FILE, beside which the episodes are kept")
    from policies.evaluate import evaluation
    from policies.evaluate.episode_log import EpisodeLog, log_path
    from policies.pretrained import fitting_robot
    from policies.rollout import CONTROLS
    from stair_env.common.progress import progress_bar

    robot = fitting_robot(args.robot, [args.policy])
    policy = args.policy or robot
    blind = args.blind_policy or (policy if policy in CONTROLS else f"{policy}-blind")
    actors = {evaluation.SOURCE_SETUPS[name].actor for name in args.source}
    sizes = {name: getattr(args, name) for name in ("risers", "treads") if getattr(args, name)}
    if sizes and args.stairs != "grid":
        raise ValueError(f"--{next(iter(sizes))} is for --stairs grid, not {args.stairs}")
    config = evaluation.EvaluationConfig(
        policy=policy if "policy" in actors else None,
        blind_policy=blind if "blind" in actors else None,
        robot=robot,
        sources=args.source,
        stairs=args.stairs,
        directions=args.direction,
        episodes=args.episodes,
        seed=args.seed,
        lighting=args.lighting,
        env_kwargs=physics_kwargs(args),
        workers=args.workers,
        engine=args.engine,
        ray_address=args.ray_address,
        network_server=args.network_server,
        **sizes,
    )
    _check_policies(config)
    log = None
    if args.json and takes_files_beside(args.json):
        log = EpisodeLog(log_path(args.json), evaluation.episode_settings(config), resume=args.resume)
    with progress_bar(evaluation.count_episodes(config), "evaluate", unit="episode") as bar:
        records = evaluation.run_all(config, bar.update, log)
    results = evaluation.tabulate(config, records)
    if args.json:
        settings = {name: getattr(config, name) for name in SETTINGS}
        write_json(args.json, {**settings, **results}, seed=args.seed)
    print(format_table(results))
    if args.stairs == "ladder":
        _show_ladder({**{name: getattr(config, name) for name in SETTINGS}, "seed": args.seed, **results}, args.figure)
    elif args.figure:
        from policies.report.figures import draw_success

        draw_success(results["cells"], args.figure)
    if args.rerun:
        for path in evaluation.log_chosen(config, records, args.rerun):
            print(f"rerun: {path}")
    if args.film:
        for video in evaluation.film_chosen(config, records, args.film):
            print(f"video: {video}")
    return 0


def _check_policies(config: Any) -> None:
    """A missing policy is reported before the workers start."""
    from policies.pretrained import locate
    from policies.rollout import CONTROLS

    for policy in (config.policy, config.blind_policy):
        if policy is not None and policy not in CONTROLS:
            locate(policy)


def _show_ladder(results: dict[str, Any], figure: Path | None) -> None:
    """The ladder's table in Markdown, and its picture."""
    from policies.evaluate.leaderboard import rows_of, summary_table
    from policies.report.figures import draw_ladder

    rows = rows_of(results)
    print(f"\n{summary_table(rows)}")
    if figure:
        draw_ladder(rows, figure)


def format_table(results: dict[str, Any]) -> str:
    """Success by source and direction, as text."""
    lines = [f"{'source':<10}{'direction':<11}{'success':>9}{'95 % interval':>18}{'steps climbed':>15}{'episodes':>10}"]
    for source, overall in results["overall"].items():
        cells = [cell for cell in results["cells"] if cell["source"] == source]
        for direction in dict.fromkeys(cell["direction"] for cell in cells):
            part = [cell for cell in cells if cell["direction"] == direction]
            successes, episodes = (sum(cell[name] for cell in part) for name in ("successes", "episodes"))
            lines.append(_table_row(source, direction, successes, episodes))
        climbed = f"{overall['steps_climbed_fraction']:.1%}"
        lines.append(_table_row(source, "all", overall["successes"], overall["episodes"], climbed))
        if "rmse_mm" in overall:
            errors = (f"{name} {value:.1f}" for name, value in overall["rmse_mm"].items() if value is not None)
            lines.append(
                f"{'':<10}measured {overall['valid_fraction']:.1%} of the time, RMSE in mm: {', '.join(errors)}"
            )
    return "\n".join(lines)


def _table_row(source: str, direction: str, successes: int, episodes: int, climbed: str = "") -> str:
    from policies.statistics import wilson_interval

    low, high = wilson_interval(successes, episodes)
    interval = f"{low:.1%} - {high:.1%}"
    return f"{source:<10}{direction:<11}{successes / episodes:>9.1%}{interval:>18}{climbed:>15}{episodes:>10}"
