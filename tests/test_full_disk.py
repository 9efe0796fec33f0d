"""A disk that is full, or a place that takes no files: one clear line, and earlier results stay whole."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from stair_env_cli.main import main

resource = pytest.importorskip("resource")  # not on Windows
ROOM = 256  # bytes that a file may grow to; less than any result
COMMANDS = {
    "view": ("view --frames 1 --tile-width 64 --output view.png --json result.json", ("view.png", "result.json")),
    "dataset": ("dataset --output set --train 2 --val 0 --test 0 --json result.json", ("result.json",)),
    "evaluate": ("evaluate --source gait --stairs random --direction up --episodes 1 --workers 1 --json result.json",
                 ("result.json",)),
}  # fmt: skip
UNWRITABLE = Path("/proc/no-such-place")


def told(errors: str, name: str) -> str:
    lines = [line for line in errors.splitlines() if line.startswith("stair-env")]
    assert "Traceback" not in errors and len(lines) == 1 and lines[0].startswith(f"stair-env {name}: error: "), errors
    return lines[0]


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_a_full_disk(name: str, tmp_path: Path) -> None:
    """Files of the process cannot grow, which Python tells as it tells of a full disk, by an OSError."""
    command, results = COMMANDS[name]
    for file in results:
        (tmp_path / file).write_bytes(b"earlier" * 100)
    before = set(tmp_path.iterdir())
    done = subprocess.run(
        [sys.executable, "-B", "-W", "ignore", "-m", "stair_env_cli.main", *command.split()],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[1])},
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, ROOM)),
    )
    assert done.returncode == 2, done.stderr
    line = told(done.stderr, name)
    assert "too large" in line or "cannot be written" in line, line
    for file in results:
        assert (tmp_path / file).read_bytes() == b"earlier" * 100
    left = {path.name for path in set(tmp_path.iterdir()) - before}
    assert not any(file.startswith(".") for file in left), left


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs a place that takes no files, whoever asks")
@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_a_place_that_takes_no_files(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = COMMANDS[name][0].split()
    option = "--output" if "--output" in words else "--json"
    words[words.index(option) + 1] = str(UNWRITABLE / "file.png")
    assert main(words) == 2
    assert str(UNWRITABLE) in told(capsys.readouterr().err, name)
