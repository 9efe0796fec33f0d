"""A results file that may join the table, and each way in which one may not."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from policies.evaluate.leaderboard import rows_of
from policies.evaluate.submission import FAULTS, SubmissionError, find_faults, read_submission

RESULTS = Path(__file__).parents[3] / "results"
GOOD = json.loads((RESULTS / "evaluate_ladder_a1.json").read_text())
TABLE = RESULTS / "benchmark.json"


def faults_of(change: Callable[[dict[str, Any]], Any], name: str | None = "mine") -> list[str]:
    content = copy.deepcopy(GOOD)
    change(content)
    known = json.loads(TABLE.read_text())["cells"]
    return [fault.name for fault in find_faults(content, name, known)]


def test_a_file_as_evaluate_wrote_it_has_no_fault() -> None:
    rows = read_submission(RESULTS / "evaluate_ladder_a1.json", "mine", TABLE)
    assert {row["policy"] for row in rows} == {"mine", "zero"} and len(rows) == len(GOOD["cells"])
    assert rows == rows_of(GOOD, "mine")


def first(content: dict[str, Any]) -> dict[str, Any]:
    cell: dict[str, Any] = content["cells"][0]
    return cell


CHANGES: list[tuple[str, Callable[[dict[str, Any]], Any]]] = [
    ("schema", lambda c: c.update(stairs="paper")),
    ("schema", lambda c: c.update(cells=[])),
    ("schema", lambda c: c.pop("robot")),
    ("schema", lambda c: first(c).pop("ci95")),
    ("schema", lambda c: first(c).update(episodes="30")),
    ("schema", lambda c: first(c).update(successes=True)),
    ("schema", lambda c: first(c).update(source="guess")),
    ("provenance", lambda c: c.pop("commit")),
    ("provenance", lambda c: c.update(date="yesterday")),
    ("provenance", lambda c: c.update(date="2999-01-01T00:00:00+00:00")),
    ("provenance", lambda c: c["machine"].pop("cpu")),
    ("robot", lambda c: c.update(robot="spot")),
    ("cells", lambda c: c.update(cells=[cell for cell in c["cells"] if cell["condition"] != "steep"])),
    ("cells", lambda c: c["cells"].append(first(c))),
    ("cells", lambda c: first(c).update(riser_height=0.05)),
    ("flights", lambda c: first(c).update(episodes=29)),
    ("seed", lambda c: c.update(seed=42)),
    ("outcomes", lambda c: first(c).update(successes=first(c)["successes"] - 1)),
    ("outcomes", lambda c: first(c).update(success_rate=0.5)),
    ("outcomes", lambda c: first(c).update(terminations={"success": 29, "fall": 1})),
    ("outcomes", lambda c: first(c).update(outcomes="2" * 30)),
    ("interval", lambda c: first(c).update(ci95=[0.9, 1.0])),
    ("interval", lambda c: first(c).update(ci95=[None, 1.0])),
    ("overall", lambda c: c["overall"]["oracle"].update(successes=1)),
    ("overall", lambda c: c["overall"].pop("gait")),
]


@pytest.mark.parametrize(("fault", "change"), CHANGES)
def test_each_fault_is_named(fault: str, change: Callable[[dict[str, Any]], Any]) -> None:
    assert fault in faults_of(change)


def test_every_kind_of_fault_is_tried() -> None:
    assert {fault for fault, _ in CHANGES} | {"policy"} == set(FAULTS)


@pytest.mark.parametrize("name", ["zero", "a1-ladder", "runs/mine/final", None])
def test_a_line_needs_a_name_of_its_own(name: str | None) -> None:
    assert faults_of(lambda c: None, name) == ["policy"]


def test_all_faults_are_told_at_once(tmp_path: Path) -> None:
    content = copy.deepcopy(GOOD)
    content["seed"] = 1
    first(content)["ci95"] = [0.0, 1.0]
    (tmp_path / "mine.json").write_text(json.dumps(content))
    with pytest.raises(SubmissionError, match=r"mine\.json has 2 faults; seed: .*; interval: ") as caught:
        read_submission(tmp_path / "mine.json", "mine", TABLE)
    assert [fault.name for fault in caught.value.faults] == ["seed", "interval"]


@pytest.mark.parametrize("text", ["{", "[1]", "\x00", "null"])
def test_no_results_file_at_all(tmp_path: Path, text: str) -> None:
    (tmp_path / "mine.json").write_text(text)
    with pytest.raises(SubmissionError, match=r"mine\.json has a fault; schema"):
        read_submission(tmp_path / "mine.json")
