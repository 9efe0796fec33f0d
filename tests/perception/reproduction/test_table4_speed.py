"""Table 4: sizes and times of the three widths."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from perception.reproduction.table4_speed import PAPER_MB, speed_table
from stair_env_cli.main import main


@pytest.fixture(scope="module")
def report() -> dict:
    return speed_table([0.25], 1)


def test_sizes_are_the_papers(report: dict) -> None:
    (row,) = report["rows"]
    assert row["state_dict_mb"] == pytest.approx(PAPER_MB[0.25], rel=0.04) == pytest.approx(row["paper_mb"], rel=0.04)
    assert 150_000 < row["parameters"] < 250_000


def test_every_back_end_is_timed_against_eager(report: dict) -> None:
    (row,) = report["rows"]
    assert {"torch_eager", "torch", "onnx"} <= set(row["ms"])
    assert set(row["times_eager"]) == set(row["ms"]) - {"torch_eager"}
    for name, ratio in row["times_eager"].items():
        assert row["ms"]["torch_eager"] / row["ms"][name] == pytest.approx(ratio, rel=0.1)


def test_the_command_writes_the_table(tmp_path: Path) -> None:
    arguments = ["--suite", "speed", "--rounds", "1", "--results", str(tmp_path)]
    assert main(["perception-evaluate", *arguments]) == 0
    written = json.loads((tmp_path / "table4.json").read_text())
    assert [row["width"] for row in written["rows"]] == [0.25]
    assert written["rows"][0]["paper_ms"]["R9 5950X + RTX A4000"] == 3.06 and written["commit"]


def test_no_rounds_are_refused() -> None:
    with pytest.raises(ValueError, match="rounds=0"):
        speed_table([0.25], 0)
