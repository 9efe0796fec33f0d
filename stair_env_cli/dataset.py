"""`stair-env dataset`: write a labelled RGB-D set in the paper's format."""

from __future__ import annotations

import argparse
from pathlib import Path

from stair_env.common.constants import LIGHTING_CHOICES, SCENE_DIRECTIONS
from stair_env_cli.arguments import (
    add_common_arguments,
    add_engine_arguments,
    chosen_engine,
    limit_threads,
    positive_int,
    progress,
    write_json,
)

PAPER_TRAIN_IMAGES = 4776  # RGB and depth images together (paper, data set introduction)
PAPER_VAL_IMAGES = 1216
LAYOUTS = ("ours", "authors")


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Declare the options."""
    parser = subparsers.add_parser(
        "dataset",
        help="write a labelled RGB-D data set",
        description="Render a labelled RGB-D set: folders images, depthes and labels per split, a JSON side-car beside "
        "each image. A folder that is partly written is completed, so an interrupted run can be started again.",
    )
    parser.add_argument("--output", type=Path, default=Path("runs/dataset"), help="folder to write (%(default)s)")
    counted = "images of the {} split, colour and depth images both counted (%(default)s)"
    parser.add_argument("--train", type=_even, default=PAPER_TRAIN_IMAGES, help=counted.format("training"))
    parser.add_argument("--val", type=_even, default=PAPER_VAL_IMAGES, help=counted.format("validation"))
    parser.add_argument("--test", type=_even, default=PAPER_VAL_IMAGES, help=counted.format("test"))
    parser.add_argument("--negatives", type=float, default=0.09, help="share of scenes without stairs (%(default)s)")
    parser.add_argument(
        "--lighting", choices=LIGHTING_CHOICES, default="random", help="light of the scenes (%(default)s)"
    )
    parser.add_argument(
        "--direction", choices=SCENE_DIRECTIONS, default="any", help="where the stairs lead (%(default)s)"
    )
    parser.add_argument(
        "--robot-share",
        type=float,
        default=0.5,
        metavar="SHARE",
        help="of the viewpoints on a robot's head, the others are hand-held (%(default)s)",
    )
    parser.add_argument("--ideal", action="store_true", help="leave out the errors of a D435i")
    parser.add_argument(
        "--stereo",
        type=int,
        default=0,
        metavar="N",
        help="depth images more a frame, matched from infrared pairs of "
        "random stereo cameras, in folders depthes_stereo1 and so on (%(default)s)",
    )
    parser.add_argument(
        "--layout",
        choices=LAYOUTS,
        default="ours",
        help="authors: 8-bit depth and segmentation masks, as the training code of the paper's authors reads them",
    )
    parser.add_argument("--workers", type=positive_int, default=1, help="processes (%(default)s)")
    add_engine_arguments(parser)
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Write what is missing, and print how much there is."""
    limit_threads(1)
    engine = chosen_engine(args)
    from perception.data.synthetic import CLUTTER_SHARE, FrameConfig
    from perception.data.writer import DatasetPlan, complete, missing_frames, write_missing
    from stair_env.sampling import SceneSampler

    sampler = SceneSampler(
        direction=args.direction, negatives=args.negatives, lighting=args.lighting, clutter=CLUTTER_SHARE
    )
    config = FrameConfig(
        sampler=sampler,
        robot_share=args.robot_share,
        sensor_errors=not args.ideal,
        stereo_variants=args.stereo,
    )
    plan = DatasetPlan(
        args.output,
        {"train": args.train // 2, "val": args.val // 2, "test": args.test // 2},
        seed=args.seed,
        config=config,
    )
    total = len(missing_frames(plan))
    for _ in progress(write_missing(plan, engine), total=total, description="frames"):
        pass
    summary = complete(plan)
    if args.layout == "authors":
        from perception.data.authors_layout import convert

        for split in plan.frames:
            for _ in progress(convert(args.output / split), description=f"layout of {split}"):
                pass
    if args.json:
        write_json(args.json, summary, seed=args.seed)
    print(f"{args.output}: {summary['images']} images, {summary['day']} of them by day and {summary['night']} by night")
    return 0


def _even(text: str) -> int:
    """A number of images: even, since each frame is a pair."""
    value = positive_int(text) if text != "0" else 0
    if value % 2:
        raise argparse.ArgumentTypeError(f"{text!r} must be even: each frame is a colour and a depth image")
    return value
