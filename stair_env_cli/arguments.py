"""What the subcommands share: options and their types, progress bars, results with provenance."""

from __future__ import annotations

import argparse
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from pathlib import Path
from typing import Any, TypeVar

from stair_env.common.constants import BACKENDS, NETWORK_WIDTHS, PHYSICS_ENGINES
from stair_env.common.files import atomic_path, provenance, write_json
from stair_env.common.progress import progress_bar
from stair_env.common.tasks import ENGINES, Engine

__all__ = [
    "WIDTH_NAMES",
    "add_backend_argument",
    "add_common_arguments",
    "add_engine_arguments",
    "add_network_server_argument",
    "add_physics_argument",
    "atomic_path",
    "choice_list",
    "chosen_engine",
    "count_list",
    "json_object",
    "json_path",
    "limit_threads",
    "non_negative_float",
    "number_list",
    "physics_kwargs",
    "positive_int",
    "progress",
    "progress_bar",
    "provenance",
    "seed_list",
    "seed_value",
    "share",
    "write_json",
]

T = TypeVar("T")

WIDTH_NAMES = tuple(map(str, NETWORK_WIDTHS))  # as an option writes them


def add_backend_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--backend`."""
    parser.add_argument(
        "--backend",
        choices=BACKENDS,
        default="onnx",
        help="what runs the network; openvino is an extra, -cuda and -tensorrt need a graphics card (%(default)s)",
    )


def add_common_arguments(parser: argparse.ArgumentParser, *, default_seed: int = 0) -> None:
    """Add `--seed` and `--json`, which every subcommand has."""
    parser.add_argument("--seed", type=seed_value, default=default_seed, help="seed of every random draw (%(default)s)")
    parser.add_argument("--json", type=json_path, metavar="FILE", help="write machine-readable results to FILE")


def add_physics_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--physics`, which `physics_kwargs` makes the environments' `engine` (`--engine` is where work is done)."""
    parser.add_argument(
        "--physics",
        choices=PHYSICS_ENGINES,
        help="engine that moves the robot; mujoco needs stair-env[mujoco] (the environment's default: bullet)",
    )


def physics_kwargs(args: argparse.Namespace) -> dict[str, Any]:
    """Arguments of the environments as `--physics` and `--env-kwargs` say; a missing engine is told before the work.

    Raises:
        ValueError: the two name different engines, or there is no such engine.
        MissingExtraError: the engine is not installed.
    """
    kwargs = dict(args.env_kwargs)
    if args.physics is not None and kwargs.setdefault("engine", args.physics) != args.physics:
        raise ValueError(f"--physics {args.physics} and --env-kwargs engine={kwargs['engine']!r} differ")
    if "engine" in kwargs:
        from stair_env.physics.engines import check_engine

        if check_engine(kwargs["engine"]) == PHYSICS_ENGINES[0]:
            kwargs.pop("engine")  # so that results read the same whether the default was named or not
    return kwargs


SAME_RESULTS = "what spreads the work; Ray needs stair-env[ray] and brings the same results (%(default)s)"


def add_engine_arguments(
    parser: argparse.ArgumentParser, engines: Sequence[str] = ENGINES, text: str = SAME_RESULTS
) -> None:
    """Add `--engine` and `--ray-address`."""
    parser.add_argument("--engine", choices=engines, default="local", help=text)
    parser.add_argument(
        "--ray-address",
        metavar="HOST:PORT",
        help="of a running Ray cluster (one is started here, with --workers cores)",
    )


def add_network_server_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--network-server`."""
    parser.add_argument(
        "--network-server",
        action="store_true",
        help="with Ray: one network for all cameras, on a graphics card where the cluster has one (each its own)",
    )


def chosen_engine(args: argparse.Namespace) -> Engine:
    """What `--engine`, `--workers` and `--ray-address` say."""
    return Engine(args.engine, args.workers, args.ray_address)


def seed_value(text: str) -> int:
    """Parse a seed: a whole number >= 0."""
    return _whole_number(text, minimum=0)


def positive_int(text: str) -> int:
    """Parse a whole number >= 1."""
    return _whole_number(text, minimum=1)


def positive_float(text: str) -> float:
    """Parse a finite number > 0."""
    value = _number(text)
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} must be a number > 0")
    return value


def non_negative_float(text: str) -> float:
    """Parse a finite number >= 0."""
    value = _number(text)
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} must be a number >= 0")
    return value


def share(text: str) -> float:
    """Parse a number from 0 to 1."""
    value = _number(text)
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} must be a number from 0 to 1")
    return value


def _number(text: str) -> float:
    """What a text says, or not-a-number."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def seed_list(text: str) -> tuple[int, ...]:
    """Parse comma-separated seeds; repeats are dropped."""
    return tuple(dict.fromkeys(seed_value(item) for item in text.split(",")))


def count_list(text: str) -> tuple[int, ...]:
    """Parse comma-separated whole numbers >= 1; repeats are dropped."""
    return tuple(dict.fromkeys(positive_int(item) for item in text.split(",")))


def number_list(text: str) -> tuple[float, ...]:
    """Parse comma-separated numbers > 0; repeats are dropped."""
    return tuple(dict.fromkeys(positive_float(item) for item in text.split(",")))


def _whole_number(text: str, minimum: int) -> int:
    try:
        value = int(text)
    except ValueError:
        value = minimum - 1
    if value < minimum:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number >= {minimum}")
    return value


def json_path(text: str) -> Path:
    """Parse an output file; a directory is refused now, not after an hour of work."""
    path = Path(text)
    if path.is_dir():
        raise argparse.ArgumentTypeError(f"{text!r} is a directory, expected a file")
    return path


def choice_list(choices: Iterable[str]) -> Callable[[str], tuple[str, ...]]:
    """Parser of a comma-separated list whose items must be among the choices; repeats are dropped."""
    allowed = tuple(choices)

    def parse(text: str) -> tuple[str, ...]:
        items = tuple(dict.fromkeys(item.strip() for item in text.split(",") if item.strip()))
        unknown = [item for item in items if item not in allowed]
        if unknown or not items:
            raise argparse.ArgumentTypeError(f"{text!r}: choose from {', '.join(allowed)} (comma-separated)")
        return items

    return parse


def json_object(text: str) -> dict[str, Any]:
    """Parse a JSON object."""
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not JSON: {error}") from None
    if not isinstance(value, dict):
        raise argparse.ArgumentTypeError(f"{text!r} is not a JSON object")
    return value


def progress(items: Iterable[T], *, total: int | None = None, description: str = "") -> Iterator[T]:
    """A progress bar on stderr around an iterable."""
    size = total if total is not None else len(items) if isinstance(items, Sized) else None
    with progress_bar(size, description) as bar:
        for item in items:
            yield item
            bar.update()


def limit_threads(threads: int = 1) -> None:
    """Let numeric libraries that are not yet loaded, here and in child processes, use this many threads."""
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, str(threads))
