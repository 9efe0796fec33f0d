"""The command `stair-env`: finds the subcommand's module, runs it, and turns user errors into one line.

A subcommand `some-name` lives in `stair_env_cli/some_name.py`, or a folder of that name, and offers
`add_parser(subparsers)` and `run(args) -> int`. Only the chosen one is imported, so `stair-env --help` stays quick.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import sys
from collections.abc import Iterator, Sequence
from importlib import metadata
from types import ModuleType

from stair_env.common.console import unbreakable_streams
from stair_env.common.files import is_standard_output
from stair_env.common.importing.extras import MissingExtraError, naming_extras
from stair_env.common.importing.shadowing import ShadowedPackageError

COMMANDS: dict[str, str] = {
    "demo": "the shipped policy climbs with perception in the loop; annotated video and summary",
    "view": "render staircases or sensor frames to PNG",
    "watch": "watch a robot climb in a browser page, and interfere",
    "train": "train a policy with Stable-Baselines3 or RLlib",
    "evaluate": "compare stair sources on paired episodes",
    "publish": "write a policy as a folder for the Hugging Face hub",
    "benchmark": "all policies on the ladder, in one table that takes rows of one's own",
    "perceive": "measure stairs in RGB-D images, recordings, or what a RealSense sees",
    "record": "write a set in the training format, or a recording, from a device or a recording",
    "calibrate": "where the camera sits on the robot, from the floor or stairs in view",
    "dataset": "write a labelled RGB-D data set",
    "perception-train": "train StairNetV2",
    "perception-export": "write trained weights for ONNX Runtime and OpenVINO",
    "perception-evaluate": "accuracy, recall and IOU of a detector",
    "measure": "errors of step width and height on the paper's six stairs",
    "bench": "time and memory ratios, each pair measured in one run",
}
TRACEBACK_VARIABLE = "STAIR_ENV_TRACEBACK"
TORCH_WRITING = ("PytorchStreamWriter", "unexpected pos")
EXIT_USER_ERROR = 2  # the code argparse uses for a wrong option
EXIT_INTERRUPTED = 130  # 128 + SIGINT, as shells report it


def main(argv: Sequence[str] | None = None) -> int:
    """Run `stair-env`.

    Args:
        argv: arguments without the program's name; None takes those of the process.

    Returns:
        The exit code: 0 done, 2 bad input, 130 interrupted, else what the subcommand returned.
    """
    with unbreakable_streams():
        return _main(list(sys.argv[1:] if argv is None else argv))


def _main(arguments: list[str]) -> int:
    chosen = next((word for word in arguments if not word.startswith("-")), None)
    module = _import_command(chosen) if chosen in COMMANDS else None
    args = _build_parser(chosen, module).parse_args(arguments)
    if module is None:  # a word that is no command has already ended in parse_args
        raise AssertionError(f"no module for {args.command!r}")
    try:
        with naming_extras(), _room_for_results(args):
            return int(module.run(args) or 0)
    except KeyboardInterrupt:
        print("stair-env: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except Exception as error:
        if args.traceback or not is_user_error(error):
            raise
        print(f"stair-env {args.command}: error: {describe(error)}", file=sys.stderr)
        return EXIT_USER_ERROR


def is_user_error(error: Exception) -> bool:
    """Whether an error speaks about the input (bad value, missing file, unknown environment) and not about a bug."""
    told = isinstance(error, (ValueError, OSError, ShadowedPackageError, MissingExtraError))
    return told or type(error).__module__ == "gymnasium.error" or _is_full_disk(error)


def _is_full_disk(error: Exception) -> bool:
    """Whether torch could not write a file, of which its own error says nothing but that."""
    return isinstance(error, RuntimeError) and any(sign in str(error) for sign in TORCH_WRITING)


def describe(error: Exception) -> str:
    """The error's message on one line."""
    text = " ".join(str(error).split()) or "no message"
    if _is_full_disk(error):
        return f"a file cannot be written, is the disk full? ({text.partition('.')[0]})"
    plain = isinstance(error, (ValueError, OSError, ImportError))
    return text if plain else f"{type(error).__name__}: {text}"


@contextlib.contextmanager
def _room_for_results(args: argparse.Namespace) -> Iterator[None]:
    """Where results go to standard output (`--json /dev/stdout`), what is printed for people goes to standard error."""
    if args.json is not None and is_standard_output(args.json):
        with contextlib.redirect_stdout(sys.stderr):
            yield
    else:
        yield


def _import_command(command: str) -> ModuleType:
    return importlib.import_module(f"stair_env_cli.{command.replace('-', '_')}")


def _build_parser(chosen: str | None, module: ModuleType | None) -> argparse.ArgumentParser:
    """The whole parser; commands that were not chosen take part with name and help only."""
    parser = argparse.ArgumentParser(
        prog="stair-env",
        description="Legged robots climb stairs on what a simulated RealSense D435i and StairNetV2 measure.",
        epilog="`stair-env COMMAND --help` lists the options of a command.",
    )
    parser.add_argument("--version", action="version", version=f"stair-env {metadata.version('stair-env')}")
    parser.add_argument(
        "--traceback",
        action="store_true",
        default=bool(os.environ.get(TRACEBACK_VARIABLE)),
        help=f"show the full traceback of an error (also: environment variable {TRACEBACK_VARIABLE}=1)",
    )
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, text in COMMANDS.items():
        if name == chosen and module is not None:
            module.add_parser(subparsers)
        else:
            subparsers.add_parser(name, help=text)
    return parser


if __name__ == "__main__":
    sys.exit(main())
