"""What the subcommands share: common options, provenance, atomic files, progress bars."""

from __future__ import annotations

import argparse
import contextlib
import datetime
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

PACKAGE_DIR = Path(__file__).resolve().parents[1]
GIT_TIMEOUT_S = 10.0


def add_common_arguments(parser: argparse.ArgumentParser, *, default_seed: int = 0) -> None:
    """Add `--seed` and `--json`, which every subcommand has."""
    parser.add_argument("--seed", type=seed_value, default=default_seed, help="seed of every random draw (%(default)s)")
    parser.add_argument("--json", type=json_path, metavar="FILE", help="write machine-readable results to FILE")


def seed_value(text: str) -> int:
    """Parse a seed: a whole number >= 0."""
    return _whole_number(text, minimum=0)


def positive_int(text: str) -> int:
    """Parse a whole number >= 1."""
    return _whole_number(text, minimum=1)


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


def write_json(path: Path | str, payload: dict[str, Any], *, seed: int | None = None) -> None:
    """Write results with their provenance; the file appears whole or not at all.

    Args:
        path: target file; missing folders are made.
        payload: JSON-able results.
        seed: seed of the run, or None when nothing was drawn.
    """
    text = json.dumps({**payload, **provenance(seed)}, indent=2, default=_plain) + "\n"
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _plain(value: Any) -> Any:
    """JSON form of NumPy values and paths."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} is not JSON-able")


@contextlib.contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary file beside `path` that takes its place when the block ends without an error."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.stem}.", suffix=target.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # mkstemp makes private files
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def provenance(seed: int | None = None) -> dict[str, Any]:
    """Where results come from: seed, commit, UTC date, machine."""
    return {
        "seed": seed,
        "commit": git_commit(),
        "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "machine": {
            "system": platform.platform(),
            "cpu": _cpu_name(),
            "cores": os.cpu_count(),
            "python": platform.python_version(),
        },
    }


def git_commit() -> str:
    """The checkout's commit, "-dirty" when tracked files changed; "unknown" for an installed package."""
    tracked = _git("ls-files", "--error-unmatch", "__init__.py")
    commit = _git("rev-parse", "HEAD")
    if not tracked or not commit:
        return "unknown"
    return commit + ("-dirty" if _git("status", "--porcelain", "--untracked-files=no") else "")


def _git(*arguments: str) -> str:
    try:
        done = subprocess.run(
            ["git", "-C", str(PACKAGE_DIR), *arguments], capture_output=True, text=True, timeout=GIT_TIMEOUT_S
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def _cpu_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def progress(items: Iterable[T], *, total: int | None = None, description: str = "") -> Iterable[T]:
    """A progress bar on stderr around an iterable."""
    from tqdm import tqdm

    bar: Iterable[T] = tqdm(items, total=total, desc=description, file=sys.stderr, dynamic_ncols=True)
    return bar


def limit_threads(threads: int = 1) -> None:
    """Let numeric libraries that are not yet loaded, here and in child processes, use this many threads."""
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, str(threads))
