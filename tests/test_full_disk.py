"""A disk that is full, or a place that takes no files: one clear line, and earlier results stay whole."""

from __future__ import annotations

from collections.abc import Iterator
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


@pytest.fixture()
def full_disk() -> Iterator[None]:
    """Files of this process cannot grow; Python turns the signal into an OSError, as a full disk is one."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def told(capsys: pytest.CaptureFixture[str], name: str) -> str:
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("stair-env")]
    assert len(lines) == 1 and lines[0].startswith(f"stair-env {name}: error: "), lines
    return lines[0]


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_a_full_disk(
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    request: pytest.FixtureRequest,
) -> None:
    monkeypatch.chdir(tmp_path)
    command, results = COMMANDS[name]
    for file in results:
        (tmp_path / file).write_bytes(b"earlier" * 100)
    before = set(tmp_path.iterdir())
    request.getfixturevalue("full_disk")
    assert main(command.split()) == 2
    line = told(capsys, name)
    assert "too large" in line or "cannot be written" in line, line
    for file in results:
        assert (tmp_path / file).read_bytes() == b"earlier" * 100
    left = {path.name for path in set(tmp_path.iterdir()) - before}
    assert not any(name.startswith(".") for name in left), left


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
    assert str(UNWRITABLE) in told(capsys, name)
