"""The table of all policies on the ladder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from policies.evaluate import leaderboard as board
from policies.evaluate.evaluation import EvaluationConfig

CELLS = (("up", "rung", 0.15), ("up", "rung", 0.23), ("down", "steep", [0.18, 0.2]))


def results(outcomes: str = "1101", **changes: Any) -> dict[str, Any]:
    """What `stair-env evaluate --stairs ladder` writes, with the same outcomes in each cell."""
    source = changes.pop("source", "oracle")
    cells = [
        {
            "source": source,
            "direction": direction,
            "condition": condition,
            "riser_height": riser,
            "tread_depth": [0.25, 0.32],
            "episodes": len(outcomes),
            "successes": outcomes.count("1"),
            "success_rate": outcomes.count("1") / len(outcomes),
            "outcomes": outcomes,
        }
        for direction, condition, riser in CELLS
    ]
    plain = {"stairs": "ladder", "robot": "aliengo", "policy": "aliengo", "blind_policy": None, "env_kwargs": {}}
    return {**plain, "seed": 0, "commit": "0123456789abcdef", "date": "today", "cells": cells, **changes}


def test_rows_name_who_flew() -> None:
    assert {row["policy"] for row in board.rows_of(results())} == {"aliengo"}
    assert {row["policy"] for row in board.rows_of(results(blind_policy="b", source="blind"))} == {"b"}
    gait = board.rows_of(results(policy=None, source="gait"))
    assert {(row["policy"], row["source"]) for row in gait} == {("zero", "oracle")}
    assert {row["policy"] for row in board.rows_of(results(), "mine")} == {"mine"}


def test_the_later_row_counts_and_others_stay() -> None:
    old, other = board.rows_of(results("0000")), board.rows_of(results(policy="other"))
    merged = board.merge(old, other, board.rows_of(results("1111")))
    assert len(merged) == 2 * len(CELLS)
    assert [row["successes"] for row in merged if row["policy"] == "aliengo"] == [4, 4, 4]
    assert board.merge(merged, merged) == merged


def test_rows_survive_a_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.json"
    file.write_text(json.dumps(results()))
    rows = board.read_rows(file)
    assert board.merge(board.rows_of(results()), rows) == rows
    (tmp_path / "table.json").write_text(json.dumps({"stairs": "ladder", "cells": rows}))
    assert board.read_rows(tmp_path / "table.json") == rows
    assert {row["policy"] for row in board.read_rows(tmp_path / "table.json", "renamed")} == {"renamed"}


def test_other_files_are_refused_by_name(tmp_path: Path) -> None:
    for text in ("[1]", "{", json.dumps(results(stairs="paper"))):
        (tmp_path / "other.json").write_text(text)
        with pytest.raises(ValueError, match=r"other\.json"):
            board.read_rows(tmp_path / "other.json")


def test_the_best_stands_first_and_is_compared_flight_by_flight() -> None:
    gait, ours = board.rows_of(results("100010", policy="zero")), board.rows_of(results("111111"))
    worse = board.rows_of(results("000011", policy="worse"))
    lines = board.summary_table([*gait, *worse, *ours]).splitlines()[2:]
    assert [line.split(" | ")[0] for line in lines] == ["| aliengo", "| zero", "| worse"]
    assert "100% (82-100) | +12 -0 (p < 0.001) | 100% | 100% | 100%" in lines[0]
    assert "+3 -3 (p = 1.000)" in lines[2]


def test_another_seed_is_no_pair() -> None:
    gait, ours = board.rows_of(results("0000", policy="zero")), board.rows_of(results("1111", seed=1))
    assert "+0 -0" in board.summary_table([*gait, *ours])


def test_page_marks_what_is_beyond_chance(tmp_path: Path) -> None:
    gait = board.rows_of(results("0" * 8, policy="zero"))
    board.write_page([*gait, *board.rows_of(results("1" * 8))], tmp_path / "page.md", "picture.png")
    text = (tmp_path / "page.md").read_text()
    assert "100% (68-100) ▲" in text and "▼ |" not in text and "![Success over the ladder](picture.png)" in text
    assert "| aliengo | aliengo | oracle | 8 | 0 | 0123456789ab | today |" in text


def test_plan_flies_blind_policies_blind_and_controls_on_each_robot() -> None:
    configs = board.plan(("aliengo-blind", "a1", "zero"), ("oracle", "noisy"), ("up",), 3, 7)
    flown = [(c.policy, c.blind_policy, c.robot, c.sources) for c in configs]
    assert flown == [
        (None, "aliengo-blind", "aliengo", ("blind",)),
        ("a1", None, "a1", ("oracle", "noisy")),
        ("zero", None, "aliengo", ("oracle",)),
        ("zero", None, "a1", ("oracle",)),
    ]
    with pytest.raises(ValueError, match="no/such"):
        board.plan(("no/such",), ("oracle",), ("up",), 1, 0)


def test_what_is_in_the_table_is_known() -> None:
    config = EvaluationConfig(policy="zero", sources=("oracle",), stairs="ladder", episodes=2)
    rows = [
        {
            "policy": "zero",
            "robot": "aliengo",
            "source": "oracle",
            "direction": cell.direction,
            "condition": cell.condition,
            "riser_height": cell.riser_height,
            "episodes": 2,
            "seed": 0,
        }
        for cell in config.cells()
    ]
    assert board.is_flown(config, json.loads(json.dumps(rows)))
    assert not board.is_flown(config, rows[1:])
    assert not board.is_flown(config, [{**row, "seed": 1} for row in rows])
    assert not board.is_flown(config, [{**row, "episodes": 1} for row in rows])
