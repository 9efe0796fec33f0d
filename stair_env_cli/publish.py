"""`stair-env publish`: a policy as a folder for the Hugging Face hub."""

from __future__ import annotations

import argparse
from pathlib import Path

from stair_env_cli.arguments import add_common_arguments, limit_threads, positive_int, write_json


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Declare the options."""
    parser = subparsers.add_parser(
        "publish",
        help="write a policy as a folder for the Hugging Face hub",
        description="Write model, card, film and results in the hub's layout; nothing is uploaded.",
    )
    parser.add_argument("policy", metavar="POLICY", help="shipped name, folder or model.zip")
    parser.add_argument("--output", type=Path, default=Path("runs/publish"), help="folder (%(default)s)")
    parser.add_argument("--episodes", type=positive_int, default=10, help="flights of results.json (%(default)s)")
    parser.add_argument("--no-film", action="store_true", help="write no replay.mp4")
    parser.add_argument(
        "--evaluation", type=Path, action="append", default=[], metavar="FILE", help="JSON of `evaluate`, for the card"
    )
    parser.add_argument("--minari", metavar="NAME", help="the flights as a Minari data set, e.g. stairs/aliengo-v0")
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Publish, and print what was written."""
    limit_threads(1)
    from policies.evaluate.publishing import PublishConfig, publish
    from stair_env.common.progress import progress_bar

    config = PublishConfig(
        policy=args.policy,
        episodes=args.episodes,
        film=not args.no_film,
        evaluations=tuple(args.evaluation),
        minari=args.minari,
        seed=args.seed,
    )
    with progress_bar(args.episodes, "flights", unit="flight") as bar:
        results = publish(config, args.output, bar.update)
    if args.json:
        write_json(args.json, results, seed=args.seed)
    print(f"{results['success_rate']:.0%} of {args.episodes} flights climbed; in {args.output}:")
    print("  " + "  ".join(results["files"]))
    return 0
