"""Results files: written whole or not at all, and saying where they come from."""

from __future__ import annotations

import contextlib
import datetime
import errno
import json
import os
import platform
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PACKAGE_DIR = Path(__file__).resolve().parent
GIT_TIMEOUT_S = 10.0
STANDARD_STREAMS = (1, 2)
LONGEST_PREFIX, LONGEST_SUFFIX = 40, 20  # characters of a name that its temporary file carries
COPY_BYTES = 1 << 20


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


def read_json_object(path: Path | str) -> dict[str, Any]:
    """Read a file of one JSON object.

    Raises:
        OSError: the file cannot be read.
        ValueError: it holds anything else; the message names the file.
    """
    try:
        found = json.loads(Path(path).read_bytes())
    except (ValueError, RecursionError) as error:  # no JSON, no text, or brackets without end
        raise ValueError(f"{path}: not JSON, damaged or cut short: {error}") from None
    if not isinstance(found, dict):
        raise ValueError(f"{path}: must hold a JSON object, holds {type(found).__name__}")
    return found


@contextlib.contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary file that takes the place of `path` when the block ends without an error.

    A link is followed and stays. What is no regular file (a device, a pipe, this process's standard output) is never
    replaced: it gets the content written to it. A file whose folder takes no new ones is overwritten in place.

    Raises:
        OSError: the target cannot be written; what was there before is still there.
    """
    target = Path(os.path.realpath(path))
    found = _stat(path)
    if found is not None and stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    stream = _own_stream(found)
    regular = found is None or (stat.S_ISREG(found.st_mode) and stream is None)
    if regular:
        target.parent.mkdir(parents=True, exist_ok=True)
    temporary = _temporary(target, beside=regular)
    try:
        yield temporary
        if not regular:
            _copy_into(temporary, Path(path) if stream is None else stream)
        elif temporary.parent != target.parent or not _replaced(temporary, target, found):
            _copy_into(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def takes_files_beside(path: Path | str) -> bool:
    """Whether a path is, or will be, a regular file with others beside it: no device, pipe or stream."""
    found = _stat(path)
    return found is None or (stat.S_ISREG(found.st_mode) and _own_stream(found) is None)


def is_standard_output(path: Path | str) -> bool:
    """Whether what is written to a path goes where this process prints."""
    found = _stat(path)
    return found is not None and _own_stream(found) == STANDARD_STREAMS[0]


def _stat(path: Path | str) -> os.stat_result | None:
    """Of what a path leads to; None where nothing is yet."""
    try:
        return os.stat(path)
    except FileNotFoundError:
        return None


def _own_stream(found: os.stat_result | None) -> int | None:
    """The standard stream that a path leads to, as /dev/stdout does: text already in it must not be cut off."""
    for descriptor in STANDARD_STREAMS:
        with contextlib.suppress(OSError):
            if found is not None and os.path.samestat(found, os.fstat(descriptor)):
                return descriptor
    return None


def _temporary(target: Path, *, beside: bool) -> Path:
    """An empty temporary file with the target's suffix, beside it where that can be."""
    suffix = target.suffix if len(target.suffix) <= LONGEST_SUFFIX else ""
    prefix = f".{target.stem[:LONGEST_PREFIX]}."
    try:
        handle, name = tempfile.mkstemp(dir=target.parent if beside else None, prefix=prefix, suffix=suffix)
    except OSError:
        if not beside or not os.access(target, os.W_OK):
            raise
        return _temporary(target, beside=False)  # one file mounted or writable within a read-only folder
    os.close(handle)
    return Path(name)


def _replaced(temporary: Path, target: Path, found: os.stat_result | None) -> bool:
    """Put the temporary file in the target's place, with the permissions it had; False where that cannot be done."""
    if found is None:
        umask = os.umask(0)
        os.umask(umask)
        mode = 0o666 & ~umask  # mkstemp makes private files
    else:
        mode = stat.S_IMODE(found.st_mode)
    temporary.chmod(mode)
    try:
        os.replace(temporary, target)
    except OSError as error:
        if error.errno != errno.EBUSY:  # a mount point, as a container's single file is
            raise
        return False
    return True


def _copy_into(source: Path, target: Path | int) -> None:
    """Write a file's content into an open descriptor, or into whatever a path leads to."""
    if isinstance(target, int):
        for text_stream in (sys.stdout, sys.stderr):
            if text_stream is not None:
                text_stream.flush()
        with source.open("rb") as content:
            while block := content.read(COPY_BYTES):
                while block:
                    block = block[os.write(target, block) :]
        return
    with source.open("rb") as content, target.open("wb") as file:
        shutil.copyfileobj(content, file)


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
