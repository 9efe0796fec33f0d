"""The results page says what the files say."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from stair_env_cli.results_page import describe_file, write_page

CONTENT = {
    "seed": 7,
    "commit": "0123456789abcdef",
    "date": "2026-01-01",
    "machine": {"cpu": "some cpu", "cores": 2},
    "policy": "aliengo",
    "notes": ["The oracle leads.", "By a lot."],
    "cells": [
        {"source": "oracle", "ci95": [0.51234, 1.0], "terminations": {"fall": 1}},
        {"source": "gait", "extra": None},
    ],
    "overall": {"oracle": {"success_rate": 0.987654}},
}


def test_page_holds_tables_and_provenance(tmp_path: Path) -> None:
    (tmp_path / "b.json").write_text(json.dumps(CONTENT))
    (tmp_path / "a.json").write_text(json.dumps({"rows": [{"x": 1}]}))
    (tmp_path / "b.png").write_bytes(b"")
    text = write_page(tmp_path).read_text()
    assert text.index("## a") < text.index("## b")
    for part in (
        "seed 7",
        "commit 0123456789ab,",
        "some cpu, 2 cores",
        "0.5123, 1",
        "| oracle | 0.9877 |",
        "- The oracle leads.\n- By a lot.\n",
        "![b](b.png)",
    ):
        assert part in text
    assert "terminations" not in text and "- policy: aliengo" in text


def test_broken_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text("{")
    with pytest.raises(ValueError, match=r"x\.json"):
        write_page(tmp_path)
    (tmp_path / "x.json").write_text("[1]")
    with pytest.raises(ValueError, match="JSON object"):
        describe_file(tmp_path / "x.json")
    with pytest.raises(FileNotFoundError):
        write_page(tmp_path / "none")
