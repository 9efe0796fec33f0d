"""`stair-env record`: frames of a device or a recording as a set to be labelled, or as a recording."""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path
from typing import Any

from stair_env.common.constants import NETWORK_WIDTHS
from stair_env_cli.arguments import add_backend_argument, add_common_arguments, positive_int, progress, write_json
from stair_env_cli.source_arguments import add_source_arguments, open_from

LABELS = ("network", "none")
EXIT_ENDED_EARLY = 2


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "record",
        help="write a set in the training format, or a recording, from a device or a recording",
        description="Write what a source shows: a folder with images, depthes, labels and JSON side-cars as training "
        "reads it, or with --output NAME.bag, .db3 or .mcap a ROS recording.",
    )
    add_source_arguments(parser)
    parser.add_argument("--output", type=Path, default=Path("runs/recorded"), help="folder or file (%(default)s)")
    parser.add_argument(
        "--labels",
        choices=LABELS,
        default="network",
        help="drafts of the labels: the network's lines, to be checked by hand, or none (%(default)s)",
    )
    parser.add_argument("--every", type=positive_int, default=1, metavar="N", help="take each Nth frame (%(default)s)")
    parser.add_argument("--width", type=float, choices=NETWORK_WIDTHS, default=0.25, help="of StairNetV2 (%(default)s)")
    add_backend_argument(parser)
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Write, and say how much."""
    from perception.sources.preparation import prepared
    from perception.sources.source import SourceError

    source, preparation = open_from(args)
    count, failure = 0, None
    try:
        frames = itertools.islice(prepared(source, preparation), 0, args.frames, args.every)
        write = _write_recording if args.output.suffix else _write_set
        for _ in progress(write(args, frames), total=args.frames, description="frames"):
            count += 1
    except SourceError as error:
        failure = error
    finally:
        source.close()
    if args.json is not None:
        payload: dict[str, Any] = {"source": source.name, "output": str(args.output), "frames": count}
        write_json(args.json, payload | ({} if failure is None else {"error": str(failure)}), seed=args.seed)
    if failure is not None and count == 0:
        raise failure
    print(f"{args.output}: {count} frames")
    if failure is not None:
        print(f"stair-env record: error: {failure}", file=sys.stderr)
        return EXIT_ENDED_EARLY
    return 0


def _write_recording(args: argparse.Namespace, frames: Any) -> Any:
    from perception.sources.recording import recording

    with recording(args.output) as recorder:
        for frame in frames:
            recorder.add(frame)
            yield frame


def _write_set(args: argparse.Namespace, frames: Any) -> Any:
    from perception.looking.recorded_set import RecordedSet

    detector = None
    if args.labels == "network":
        from perception.inference.detector import NetworkDetector

        detector = NetworkDetector(args.width, args.backend)
    written = RecordedSet(args.output, detector)
    for frame in frames:
        if frame.depth_m is not None:  # the training format has depth in every frame
            written.add(frame)
            yield frame
