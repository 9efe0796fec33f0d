"""Flights on several workers against one."""

from __future__ import annotations

import pytest

from stair_env.common.tasks import Engine
from stair_env_cli.bench import scale_rows


def test_a_row_holds_the_ratio_of_its_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale_rows, "seconds_per_1000_steps", lambda engine: 6.0 / engine.workers)
    rows = scale_rows.scale_rows((1, 3), "local", None, rounds=2)
    assert [(row.ours, row.theirs, row.ratio, row.rounds) for row in rows] == [(6.0, 6.0, 1.0, 2), (2.0, 6.0, 3.0, 2)]
    assert "3 workers (local)" in rows[1].name


def test_steps_take_time() -> None:
    assert 0.0 < scale_rows.seconds_per_1000_steps(Engine(), flights=2) < 600.0
