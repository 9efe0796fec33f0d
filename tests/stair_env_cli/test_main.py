"""The command line: dispatch, one clear line on bad input, results that appear whole."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from stair_env_cli import arguments, main


def fake_command(run: Callable[[argparse.Namespace], int]) -> types.ModuleType:
    module = types.ModuleType("fake")

    def add_parser(subparsers: argparse._SubParsersAction) -> None:
        arguments.add_common_arguments(subparsers.add_parser("view"))

    module.add_parser = add_parser  # type: ignore[attr-defined]
    module.run = run  # type: ignore[attr-defined]
    return module


def raising(error: Exception) -> Callable[[argparse.Namespace], int]:
    def run(args: argparse.Namespace) -> int:
        raise error

    return run


def use_command(monkeypatch: pytest.MonkeyPatch, run: Callable[[argparse.Namespace], int]) -> None:
    monkeypatch.setattr(main, "_import_command", lambda name: fake_command(run))


@pytest.mark.parametrize(
    "error", [ValueError("robot='x' must be one of 'a1'\nor so"), FileNotFoundError(2, "No such file", "image.png")]
)
def test_bad_input_is_one_line_and_code_2(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_command(monkeypatch, raising(error))
    assert main.main(["view"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("stair-env view: error: ") and captured.err.count("\n") == 1


def test_a_bug_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    use_command(monkeypatch, raising(ZeroDivisionError("a bug")))
    with pytest.raises(ZeroDivisionError):
        main.main(["view"])


def test_traceback_option_shows_user_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    use_command(monkeypatch, raising(ValueError("wrong")))
    with pytest.raises(ValueError, match="wrong"):
        main.main(["--traceback", "view"])


def test_exit_code_of_the_command_is_returned(monkeypatch: pytest.MonkeyPatch) -> None:
    use_command(monkeypatch, lambda args: 7 + args.seed)
    assert main.main(["view", "--seed", "3"]) == 10


@pytest.mark.parametrize("arguments", [[], ["nonsense"], ["view", "--seed", "-1"], ["view", "--seed", "x"]])
def test_wrong_arguments_exit_with_2(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    use_command(monkeypatch, lambda args: 0)
    with pytest.raises(SystemExit) as stop:
        main.main(arguments)
    assert stop.value.code == 2


def test_help_lists_every_command() -> None:
    done = subprocess.run([sys.executable, "-m", "stair_env_cli.main", "--help"], capture_output=True, text=True)
    assert done.returncode == 0
    assert all(f" {name}" in done.stdout for name in main.COMMANDS)


@pytest.mark.parametrize("name", sorted(main.COMMANDS))
def test_every_command_exists_and_has_the_common_options(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main.main([name, "--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert "--seed" in text and "--json" in text


def test_choice_list_names_the_choices() -> None:
    parse = arguments.choice_list(["oracle", "blind"])
    assert parse("blind,oracle,blind") == ("blind", "oracle")
    for text in ("", "seeing", "oracle,seeing"):
        with pytest.raises(argparse.ArgumentTypeError, match="oracle, blind"):
            parse(text)


def test_results_carry_their_provenance(tmp_path: Path) -> None:
    path = tmp_path / "new" / "out.json"
    arguments.write_json(path, {"value": np.float32(0.5), "rows": np.arange(2)}, seed=4)
    written = json.loads(path.read_text())
    assert written["value"] == 0.5 and written["rows"] == [0, 1] and written["seed"] == 4
    assert {"commit", "date", "machine"} <= set(written)
    assert [item.name for item in path.parent.iterdir()] == ["out.json"]


def test_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    path.write_text("old")
    with pytest.raises(RuntimeError), arguments.atomic_path(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError("killed")
    assert path.read_text() == "old"
    assert [item.name for item in tmp_path.iterdir()] == ["out.json"]


def test_json_option_refuses_a_directory(tmp_path: Path) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="directory"):
        arguments.json_path(str(tmp_path))
