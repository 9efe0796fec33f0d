"""`stair-env demo`: the shipped policy climbs with perception in the loop."""

from __future__ import annotations

import argparse
from pathlib import Path

from stair_env.common.constants import DEMO_LIGHTINGS, EPISODE_DIRECTIONS
from stair_env_cli.arguments import add_common_arguments, limit_threads, positive_int, write_json


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Declare the options."""
    parser = subparsers.add_parser(
        "demo",
        help="the shipped policy climbs with perception in the loop; annotated video and summary",
        description="Climb a few flights on what the camera sees; write demo.mp4 and summary.json.",
    )
    parser.add_argument("--output", type=Path, default=Path("runs/demo"), help="folder (%(default)s)")
    parser.add_argument("--episodes", type=positive_int, default=4, help="flights to climb (%(default)s)")
    parser.add_argument("--policy", metavar="NAME|FILE", help="shipped name, folder or model.zip (the robot's name)")
    parser.add_argument("--robot", metavar="NAME", help="robot (the policy's, or aliengo)")
    parser.add_argument("--direction", choices=EPISODE_DIRECTIONS, default="both", help="(%(default)s)")
    parser.add_argument("--lighting", choices=DEMO_LIGHTINGS, default="both", help="(%(default)s)")
    parser.add_argument("--rerun", type=Path, metavar="FILE", help="also a recording for the Rerun viewer (.rrd)")
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Climb, and print where the video is."""
    limit_threads(1)
    from policies.evaluate.demo_flights import DemoConfig, run_demo
    from stair_env.common.progress import progress_bar

    config = DemoConfig(
        policy=args.policy,
        robot=args.robot,
        episodes=args.episodes,
        direction=args.direction,
        lighting=args.lighting,
        seed=args.seed,
    )
    with progress_bar(None, f"climbing {args.episodes} flights", unit="step") as bar:
        summary = run_demo(config, args.output, bar.update, args.rerun)
    write_json(args.output / "summary.json", summary, seed=args.seed)
    if args.json:
        write_json(args.json, summary, seed=args.seed)
    errors = ", ".join(f"{name} {value:.1f}" for name, value in summary["rmse_mm"].items() if value is not None)
    arrived = sum(flight["success"] for flight in summary["flights"])
    print(f"{arrived} of {summary['episodes']} flights climbed; measured with an RMSE in mm of: {errors or 'nothing'}")
    print(f"video: {summary['video']}")
    print(f"summary: {args.output / 'summary.json'}")
    return 0
