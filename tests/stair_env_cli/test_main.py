"""The command line: dispatch, one clear line on bad input, results that appear whole."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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


@pytest.mark.parametrize("name", sorted(main.COMMANDS))
def test_help_is_written_for_people(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main.main([name, "--help"])
    assert "%%" not in capsys.readouterr().out


def test_results_on_standard_output_are_nothing_else(tmp_path: Path) -> None:
    """`stair-env ... --json /dev/stdout | jq`: what is printed for people goes to standard error."""
    command = [sys.executable, "-m", "stair_env_cli.main", "view", "--frames", "1", "--tile-width", "64"]
    done = subprocess.run(
        [*command, "--output", "view.png", "--json", "/dev/stdout"], capture_output=True, text=True, cwd=tmp_path
    )
    assert json.loads(done.stdout)["output"] == "view.png" and "view.png: 1 scenes" in done.stderr


def test_a_closed_pipe_loses_no_results(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "stair_env_cli.main", "view", "--frames", "1", "--tile-width", "64"]
    options = ["--output", str(tmp_path / "view.png"), "--json", str(tmp_path / "view.json")]
    done = subprocess.run([*command, *options], stdout=writer, stderr=writer, check=False)
    os.close(writer)
    assert done.returncode == 0 and json.loads((tmp_path / "view.json").read_text())["frames"]


def test_an_ascii_console_gets_every_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    code = "import sys; from stair_env_cli import main; sys.exit(main.main(['view', '--scene', sys.argv[1]]))"
    done = subprocess.run(
        [sys.executable, "-c", code, os.fsdecode(b"no such \xe9 \xe2\x82\xac.json")],
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"},
        check=False,
    )
    assert done.returncode == 2 and b"error" in done.stderr and b"Traceback" not in done.stderr


def test_a_file_that_torch_cannot_write_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_command(monkeypatch, raising(RuntimeError("[enforce fail] PytorchStreamWriter failed writing file data/3")))
    assert main.main(["view"]) == 2
    assert "disk full" in capsys.readouterr().err


TEXTS = ("", "-1", "0", "1", "7", "1e309", "nan", "inf", "-0", "x", ",", "0.1,", "{}", "[]", '{"a": 1}', "\ud800", "-")
PIECES = st.sampled_from(TEXTS)


@pytest.mark.parametrize("name", sorted(main.COMMANDS))
@settings(max_examples=60)
@given(data=st.data())
def test_any_arguments_are_read_or_refused_with_code_2(name: str, data: st.DataObject) -> None:
    module = main._import_command(name)
    parser = main._build_parser(name, module)
    options = [action for action in command_parser(parser, name)._actions if action.option_strings]
    words = [name]
    for action in data.draw(st.lists(st.sampled_from(options), max_size=4)):
        words += [action.option_strings[0], *data.draw(st.lists(PIECES, max_size=2))]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            parser.parse_args(words)
        except SystemExit as end:
            assert end.code in (0, 2)


def command_parser(parser: argparse.ArgumentParser, name: str) -> argparse.ArgumentParser:
    choices = next(action.choices for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    return choices[name]  # type: ignore[index]
