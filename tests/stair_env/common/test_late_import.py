"""An action that waits for another package's import happens once, right after it, and the package is none the wiser."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from stair_env.common.importing.late_import import when_imported


def test_it_happens_after_the_import_and_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "awaited_package.py").write_text("VALUE = 3\n")
    monkeypatch.syspath_prepend(tmp_path)
    heard: list[int] = []
    before = len(sys.meta_path)
    when_imported("awaited_package", lambda: heard.append(sys.modules["awaited_package"].VALUE))
    assert heard == []
    try:
        module = importlib.import_module("awaited_package")
        assert heard == [3] and len(sys.meta_path) == before
        assert type(module.__loader__).__name__ == "SourceFileLoader" == type(module.__spec__.loader).__name__
        importlib.reload(module)
        assert heard == [3]
        when_imported("awaited_package", lambda: heard.append(0))
        assert heard == [3, 0]  # it is there already
    finally:
        del sys.modules["awaited_package"]


def test_a_package_that_is_not_there_stays_an_error() -> None:
    when_imported("no_such_package_anywhere", lambda: None)
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("no_such_package_anywhere")
