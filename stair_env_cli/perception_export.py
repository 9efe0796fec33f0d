"""`stair-env perception-export`: trained weights as ONNX Runtime and OpenVINO read them."""

from __future__ import annotations

import argparse
from pathlib import Path

from stair_env_cli.arguments import WIDTH_NAMES, add_common_arguments, choice_list, write_json


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Declare the options."""
    parser = subparsers.add_parser(
        "perception-export",
        help="write trained weights for ONNX Runtime and OpenVINO",
        description="Write NAME.onnx from NAME.safetensors in the same folder.",
    )
    parser.add_argument(
        "--width", type=choice_list(WIDTH_NAMES), default=("0.25",), help="width factors, comma-separated (0.25)"
    )
    parser.add_argument("--weights", type=Path, metavar="DIR", help="folder of the weights (the shipped ones)")
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Export, and print what was written."""
    from perception.inference.weights import WEIGHTS_DIR, export_onnx, load_network, weights_name

    folder = args.weights if args.weights is not None else WEIGHTS_DIR
    networks = [load_network(float(width), folder) for width in args.width]
    written = []
    for network in networks:
        path = folder / f"{weights_name(network.width)}.onnx"
        export_onnx(network, path)
        written.append(str(path))
    if args.json:
        write_json(args.json, {"written": written}, seed=args.seed)
    print("\n".join(written))
    return 0
