"""Options of the commands that read frames from a device, a recording or files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from stair_env_cli.arguments import positive_float, positive_int

if TYPE_CHECKING:
    from perception.sources.preparation import Preparation
    from perception.sources.source import Source

IMU_USES = ("auto", "required", "off")
AUTO = "auto"


def add_source_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the source itself, and how it is read."""
    parser.add_argument(
        "source",
        nargs="*",
        metavar="SOURCE",
        help="a recording (.bag, .db3, .mcap), a folder, a colour image, RGB DEPTH (two files or two folders), or the "
        "word simulated",
    )
    parser.add_argument(
        "--device",
        nargs="?",
        const="",
        metavar="SERIAL",
        help="a RealSense on this machine (the first, or that number)",
    )
    parser.add_argument(
        "--gravity",
        type=float,
        nargs=3,
        metavar=("GX", "GY", "GZ"),
        help="accelerometer at rest in the camera frame, x right, y down, z forward (level: 0 -9.8 0), instead of "
        "the IMU's",
    )
    parser.add_argument("--imu", choices=IMU_USES, default="auto", help="gravity from the source's IMU (%(default)s)")
    parser.add_argument(
        "--intrinsics",
        type=Path,
        metavar="FILE",
        help="fx, fy, cx, cy; or librealsense's ppx, ppy, coeffs; or ROS's camera_info (default: the source's, else a "
        "D435i's)",
    )
    parser.add_argument("--depth-intrinsics", type=Path, metavar="FILE", help="of depth that is not aligned to colour")
    parser.add_argument(
        "--extrinsics", type=Path, metavar="FILE", help="rotation and translation from the depth to the colour camera"
    )
    parser.add_argument(
        "--depth-scale", type=float, metavar="M", help="metres a unit of depth in files (0.001; TUM folders: 0.0002)"
    )
    parser.add_argument(
        "--grey-level",
        type=_grey_level,
        metavar="M",
        help="metres a level of 8-bit depth (0.007), or auto: from the stairs in view, by the rule for steps",
    )
    parser.add_argument("--colour-topic", metavar="TOPIC", help="of a ROS recording (the one that looks like it)")
    parser.add_argument("--depth-topic", metavar="TOPIC", help="the same for depth")
    parser.add_argument("--imu-topic", metavar="TOPIC", action="append", default=[], help="the same for the IMU")
    parser.add_argument("--size", default="640x480", metavar="WxH", help="of a device's images (%(default)s)")
    parser.add_argument("--rate", type=positive_int, default=30, help="of a device, frames a second (%(default)s)")
    parser.add_argument("--filters", action="store_true", help="the SDK's post-processing of depth")
    parser.add_argument(
        "--timeout",
        type=positive_float,
        default=5.0,
        help="seconds without a frame before a device is lost (%(default)s)",
    )
    parser.add_argument("--frames", type=positive_int, metavar="N", help="stop after N frames")


def _grey_level(text: str) -> float | str:
    return AUTO if text == AUTO else positive_float(text)


def open_from(args: argparse.Namespace) -> tuple[Source, Preparation]:
    """The source that the options name, and what is done with its frames.

    Raises:
        ValueError: no source, two of them, or one that cannot be read.
    """
    from perception.sources.folders import FileOptions
    from perception.sources.opening import SourceOptions, open_source
    from perception.sources.preparation import Preparation
    from perception.sources.realsense import RealSenseOptions, open_device
    from perception.sources.ros_bags import BagTopics

    if (args.device is None) == (not args.source):
        raise ValueError("name one source: SOURCE (a recording, a folder, files), or --device")
    if args.depth_scale is not None and not 0.0 < args.depth_scale < 1.0:
        raise ValueError(f"depth-scale={args.depth_scale!r} must be metres a unit of depth, between 0 and 1")
    width, height = _size(args.size)
    need_imu = args.imu == "required"
    device = RealSenseOptions(width, height, args.rate, args.filters, need_imu, args.timeout)
    grey_level = args.grey_level if isinstance(args.grey_level, float) else None
    options = SourceOptions(
        FileOptions(args.depth_scale, grey_level),
        BagTopics(args.colour_topic, args.depth_topic, tuple(args.imu_topic)),
        device,
        frames=args.frames or 60,
        seed=args.seed,
    )
    gravity = None if args.gravity is None else tuple(args.gravity)
    preparation = Preparation(args.intrinsics, args.depth_intrinsics, args.extrinsics, gravity, args.imu)
    if args.device is not None:
        return open_device(args.device or None, device), preparation
    return open_source(args.source, options), preparation


def _size(text: str) -> tuple[int, int]:
    try:
        width, height = (int(part) for part in text.split("x"))
    except ValueError:
        raise ValueError(f"size={text!r} must be WIDTHxHEIGHT") from None
    return width, height
