"""`stair-env view`: look at random scenes as the robot's camera sees them."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from stair_env.common.constants import CAMERA_MODES, LIGHTING_CHOICES, SCENE_DIRECTIONS
from stair_env_cli.arguments import add_common_arguments, positive_int, progress, write_json


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Declare the options."""
    parser = subparsers.add_parser(
        "view",
        help="render staircases or sensor frames to PNG",
        description="Write a contact sheet of random scenes: colour, depth in false colours, labels over colour.",
    )
    parser.add_argument("--output", type=Path, default=Path("view.png"), help="PNG or JPEG to write (%(default)s)")
    parser.add_argument("--frames", type=positive_int, default=12, help="number of scenes (%(default)s)")
    parser.add_argument("--lighting", choices=LIGHTING_CHOICES, default="random", help="light (%(default)s)")
    parser.add_argument("--direction", choices=SCENE_DIRECTIONS, default="any", help="kind of stairs (%(default)s)")
    parser.add_argument("--negatives", type=float, default=0.1, help="share of scenes without stairs (%(default)s)")
    parser.add_argument("--camera", choices=CAMERA_MODES, default="640x480", help="camera mode (%(default)s)")
    parser.add_argument("--sensor", action="store_true", help="add the D435i's errors to colour and depth")
    parser.add_argument(
        "--scene", type=Path, metavar="FILE", help="JSON of one scene to look at instead of random ones"
    )
    parser.add_argument("--columns", type=positive_int, default=2, help="scenes side by side (%(default)s)")
    parser.add_argument("--tile-width", type=positive_int, default=320, help="width of a picture, pixels (%(default)s)")
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Draw the sheet, and print where it is."""
    import numpy as np

    from stair_env.intrinsics import D435I_COLOR_MODES
    from stair_env.sampling import SceneSampler, SceneSpec
    from stair_env_cli.contact_sheet import check_picture_path, contact_sheet, draw_view, write_picture

    check_picture_path(args.output)
    sampler = SceneSampler(direction=args.direction, lighting=args.lighting, negatives=args.negatives)
    given = SceneSpec.from_json(args.scene.read_text(encoding="utf-8")) if args.scene else None
    rng = np.random.default_rng(args.seed)
    views = []
    for _ in progress(range(args.frames), description="scenes"):
        spec = given if given is not None else sampler.sample(rng)
        views.append(draw_view(spec, D435I_COLOR_MODES[args.camera], rng, sensor=args.sensor))
    write_picture(args.output, contact_sheet(views, args.columns, args.tile_width))
    if args.json:
        write_json(args.json, {"output": args.output, "frames": [_describe(view) for view in views]}, seed=args.seed)
    print(f"{args.output}: {len(views)} scenes, {sum(len(view.labels) for view in views)} stair lines in view")
    return 0


def _describe(view: Any) -> dict[str, Any]:
    """A view as JSON: enough to draw it again."""
    return {
        "scene": json.loads(view.spec.to_json()),
        "camera_to_world": view.camera_to_world,
        "intrinsics": view.intrinsics.to_dict(),
        "lines": [[label.kind, label.x1, label.y1, label.x2, label.y2] for label in view.labels],
    }
