"""`stair-env calibrate`: where the camera sits on the robot, from the floor or the stairs in view."""

from __future__ import annotations

import argparse
import itertools
import math
from typing import Any

from stair_env_cli.arguments import add_common_arguments, write_json
from stair_env_cli.source_arguments import add_source_arguments, open_from

DEFAULT_FRAMES = 60


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "calibrate",
        help="the camera's height, pitch and roll against the trunk, from the floor or stairs in view",
        description="Measure the camera's mount while the robot stands still on a level floor with floor or stairs in "
        "view. The trunk is taken to be level unless its accelerometer says otherwise.",
    )
    add_source_arguments(parser)
    parser.add_argument(
        "--trunk-gravity",
        type=float,
        nargs=3,
        metavar=("GX", "GY", "GZ"),
        help="the trunk's accelerometer at rest, x forward, y left, z up (level: 0 0 9.8)",
    )
    parser.add_argument(
        "--trunk-height",
        type=float,
        metavar="M",
        help="of the trunk's origin above the floor, for the camera's z in it",
    )
    parser.add_argument("--robot", metavar="NAME", help="compare with the mount that this robot has here")
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Look, and print the mount with its uncertainty."""
    import numpy as np

    from perception.looking.mount_calibration import calibrate_mount
    from perception.sources.preparation import prepared
    from stair_env.robots import get_robot

    robot = get_robot(args.robot) if args.robot else None
    source, preparation = open_from(args)
    try:
        looked = itertools.islice(prepared(source, preparation), args.frames or DEFAULT_FRAMES)
        frames = [(f.depth_m, f.intrinsics, f.gravity) for f in looked if f.depth_m is not None]
    finally:
        source.close()
    trunk_up = None if args.trunk_gravity is None else np.array(args.trunk_gravity)
    mount = calibrate_mount(frames, trunk_up)
    payload: dict[str, Any] = {"source": source.name, "mount": mount.to_dict()}
    seen = "a floor" if mount.levels == 1 else f"stairs ({mount.levels} levels)"
    print(f"{source.name}: {mount.frames} frames, {seen} in view")
    print(f"height above the ground: {mount.height_m:.4f} ± {mount.height_std_m:.4f} m")
    degrees = [math.degrees(v) for v in (mount.pitch_down_rad, mount.pitch_std_rad, mount.roll_rad, mount.roll_std_rad)]
    print(f"pitch down: {degrees[0]:.2f} ± {degrees[1]:.2f} deg")
    print(f"roll, right side down: {degrees[2]:.2f} ± {degrees[3]:.2f} deg")
    if args.trunk_height is not None:
        payload["mount"]["z_in_trunk_m"] = mount.height_m - args.trunk_height
        print(f"z in the trunk's axes, if it is level: {payload['mount']['z_in_trunk_m']:.4f} m")
    if robot is not None:
        here = robot.camera
        payload["robot"] = {"name": args.robot, "pitch_down_rad": here.pitch_down_rad, "position": list(here.position)}
        off = math.degrees(mount.pitch_down_rad - here.pitch_down_rad)
        print(
            f"{args.robot} here: pitch down {math.degrees(here.pitch_down_rad):.2f} deg; measured is {off:+.2f} deg off"
        )
    if args.json is not None:
        write_json(args.json, payload, seed=args.seed)
    return 0
