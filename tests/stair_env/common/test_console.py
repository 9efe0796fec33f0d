"""What is printed cannot break a command: closed pipes, ASCII consoles, full disks."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stair_env.common.console import UnbreakableStream, stdout_to_stderr, unbreakable_streams

GUARDED = "from stair_env.common.console import *\nwith unbreakable_streams():\n    {}\nimport sys; sys.exit(7)"


@given(st.text(st.characters(codec=None, exclude_categories=())))
def test_any_text_reaches_an_ascii_console(text: str) -> None:
    raw = io.BytesIO()
    stream = UnbreakableStream(io.TextIOWrapper(raw, encoding="ascii", newline=""))
    assert stream.write(text) == len(text)
    stream.flush()
    assert raw.getvalue() == text.encode("ascii", "backslashreplace")


@pytest.mark.parametrize("where", ["stdout", "stderr"])
def test_a_pipe_that_nobody_reads_stops_nothing(where: str) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    code = GUARDED.format(f"import sys; [print('x' * 1000, file=sys.{where}) for _ in range(500)]")
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, where: writer}
    done = subprocess.run([sys.executable, "-c", code], **streams, check=False)
    os.close(writer)
    assert done.returncode == 7 and not done.stdout and not done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_stops_nothing() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, "-c", GUARDED.format("print('x')")], stdout=full, check=False)
    assert done.returncode == 7


def test_closed_and_missing_streams_are_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    closed = io.StringIO()
    closed.close()
    monkeypatch.setattr(sys, "stdout", closed)
    monkeypatch.setattr(sys, "stderr", None)
    with unbreakable_streams():
        print("nobody hears this")
    assert sys.stdout is closed and sys.stderr is None


def test_what_c_prints_goes_to_standard_error(capfd: pytest.CaptureFixture[str]) -> None:
    with stdout_to_stderr():
        os.write(1, b"from C\n")
    os.write(1, b"ours\n")
    out, err = capfd.readouterr()
    assert (out, err) == ("ours\n", "from C\n")
