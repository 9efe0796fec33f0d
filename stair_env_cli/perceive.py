"""`stair-env perceive`: measure stairs in RGB-D images."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from stair_env.common.constants import GEOMETRY_METHODS, LEVEL_CAMERA_GRAVITY, NETWORK_WIDTHS
from stair_env_cli.arguments import add_backend_argument, add_common_arguments, progress, write_json


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "perceive",
        help="measure stairs in RGB-D images",
        description="Find stair lines in RGB-D images, cluster them, measure the steps, and draw what was found.",
        epilog="An optional NAME.json beside an image (fx, fy, cx, cy, gravity, depth_scale) overrides the options.",
    )
    parser.add_argument("rgb", type=Path, metavar="RGB", help="colour image (png, jpg), or a folder of them")
    parser.add_argument("depth", type=Path, metavar="DEPTH", help="depth image aligned to it, or a folder, same names")
    parser.add_argument(
        "--gravity",
        type=float,
        nargs=3,
        metavar=("GX", "GY", "GZ"),
        default=LEVEL_CAMERA_GRAVITY,
        help="accelerometer at rest in the camera frame, x right, y down, z forward (level: 0 -9.8 0)",
    )
    parser.add_argument("--intrinsics", type=Path, metavar="FILE", help="JSON with fx, fy, cx, cy (default: a D435i's)")
    parser.add_argument(
        "--depth-scale", type=float, default=0.001, metavar="M", help="metres a unit of 16-bit depth (%(default)s)"
    )
    parser.add_argument("--width", type=float, choices=NETWORK_WIDTHS, default=0.25, help="of StairNetV2 (%(default)s)")
    add_backend_argument(parser)
    parser.add_argument("--method", choices=GEOMETRY_METHODS, default="planes", help="geometry (%(default)s)")
    parser.add_argument("--output", type=Path, default=Path("perceived"), help="folder for pictures (%(default)s)")
    parser.add_argument("--no-pictures", action="store_true", help="write no annotated images")
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Measure every frame; print one line each, write pictures and JSON."""
    from perception.data.frame_files import FrameOptions, pair_files, read_frame
    from perception.drawing import draw_report
    from perception.estimator import StairEstimator

    options = FrameOptions(_read_intrinsics(args.intrinsics), tuple(args.gravity), args.depth_scale)
    pairs = pair_files(args.rgb, args.depth)
    estimator = StairEstimator(args.width, args.backend, method=args.method)
    frames: list[dict[str, Any]] = []
    for rgb_path, depth_path in progress(pairs, description="perceive") if len(pairs) > 1 else pairs:
        frame = read_frame(rgb_path, depth_path, options)
        grid = estimator.detect(frame.rgb, frame.depth_m)
        estimate = estimator.interpret(*grid, frame.depth_m, frame.intrinsics, frame.gravity)
        entry = {"rgb": str(rgb_path), "depth": str(depth_path), **estimate.to_dict()}
        if not args.no_pictures:
            entry["picture"] = str(_write_picture(args.output, frame.name, draw_report(frame.rgb, estimate, grid)))
        frames.append(entry)
    if args.json is not None:
        write_json(args.json, {"frames": frames}, seed=args.seed)
    _print(frames)
    return 0


def _read_intrinsics(path: Path | None) -> dict[str, float] | None:
    """The JSON object of an intrinsics file.

    Raises:
        ValueError: the file is no JSON object.
        OSError: it cannot be read.
    """
    if path is None:
        return None
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not JSON: {error}") from None
    if not isinstance(values, dict):
        raise ValueError(f"{path}: must be a JSON object with fx, fy, cx, cy")
    return values


def _write_picture(folder: Path, name: str, image: Any) -> Path:
    from stair_env.common.images import write_image

    path = folder / f"{name}_stairs.png"
    write_image(path, image[:, :, ::-1])
    return path


def _print(frames: list[dict[str, Any]]) -> None:
    for frame in frames:
        sizes = "  ".join(f"{1000 * s['width_m']:.0f}x{1000 * s['height_m']:.0f}" for s in frame["steps"])
        found = f"{frame['direction']}, {len(frame['lines'])} lines, width x height in mm: {sizes or '-'}"
        print(f"{Path(frame['rgb']).name}: {found if frame['valid'] else 'no stairs measured: ' + frame['reason']}")
