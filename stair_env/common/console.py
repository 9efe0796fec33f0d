"""What is printed never costs a result: streams that a closed pipe, an ASCII console or a full disk cannot break."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import warnings
from collections.abc import Iterator
from typing import Any, TextIO, cast


class UnbreakableStream:
    """A text stream whose `write` and `flush` raise nothing that the outside causes.

    Characters that the stream's encoding lacks are written as backslash escapes. After the first failure of the other
    side (a pipe that nobody reads any more, a full disk) the rest is dropped.

    Args:
        stream: where text goes.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._gone = False

    def write(self, text: str) -> int:
        """Write text as far as it can be; its length is returned in any case, as by a file."""
        if self._gone:
            return len(text)
        try:
            self._stream.write(text)
        except UnicodeEncodeError:
            encoding = self._stream.encoding or "ascii"
            self.write(text.encode(encoding, "backslashreplace").decode(encoding))
        except (OSError, ValueError):  # ValueError: closed
            self._give_up()
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write each line."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Flush as far as that can be done."""
        try:
            if not self._gone:
                self._stream.flush()
        except (OSError, ValueError):
            self._give_up()

    def _give_up(self) -> None:
        """Drop the rest; what the stream still holds goes nowhere when the interpreter flushes it at its end."""
        self._gone = True
        with contextlib.suppress(OSError, ValueError, AttributeError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def unbreakable_streams() -> Iterator[None]:
    """Guard `sys.stdout` and `sys.stderr` while the block runs."""
    before = sys.stdout, sys.stderr
    guarded = [stream if stream is None else UnbreakableStream(stream) for stream in before]
    sys.stdout, sys.stderr = (cast(TextIO, stream) for stream in guarded)
    try:
        yield
    finally:
        for stream in guarded:
            if stream is not None:
                stream.flush()
        sys.stdout, sys.stderr = before


@contextlib.contextmanager
def stdout_to_stderr() -> Iterator[None]:
    """Send to standard error what libraries in C write to standard output while the block runs."""
    try:
        kept = os.dup(1)
    except OSError:  # closed
        yield
        return
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
        os.dup2(2, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


@contextlib.contextmanager
def quiet(logger: str) -> Iterator[None]:
    """Keep a library's remarks about itself from users who can do nothing about them; its errors are still told.

    Args:
        logger: of the library.
    """
    log = logging.getLogger(logger)
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        log.setLevel(before)
