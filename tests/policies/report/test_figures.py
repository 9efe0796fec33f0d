"""Figures are drawn from results as they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio.v3 as iio
import pytest

from policies.report.figures import draw_curves, draw_ladder, draw_success


def cell(source: str, direction: str, riser: Any, tread: Any, rate: float, **other: Any) -> dict[str, Any]:
    size = {"riser_height": riser, "tread_depth": tread}
    return {"source": source, "direction": direction, **size, "success_rate": rate, **other}


def test_success_has_a_panel_for_each_source_and_direction(tmp_path: Path) -> None:
    cells = [
        cell(source, direction, riser, tread, 0.5)
        for source in ("oracle", "gait")
        for direction in ("up", "down")
        for riser in (0.1, 0.15)
        for tread in (0.25, 0.3, 0.35)
    ]
    draw_success(cells, tmp_path / "both.png")
    draw_success([c for c in cells if c["source"] == "oracle"], tmp_path / "one.png")
    both, one = iio.imread(tmp_path / "both.png"), iio.imread(tmp_path / "one.png")
    assert both.shape[1] > one.shape[1] and both[..., :3].std() > 10


def test_paper_stairs_are_drawn(tmp_path: Path) -> None:
    draw_success([cell("oracle", "up", 0.15, 0.29, 1.0, stair="Stair1")], tmp_path / "paper.png")
    assert (tmp_path / "paper.png").stat().st_size > 1000


def test_random_stairs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="grid"):
        draw_success([cell("oracle", "up", (0.1, 0.2), (0.2, 0.3), 1.0)], tmp_path / "no.png")


def test_curves_skip_missing_values(tmp_path: Path) -> None:
    row = {"return_mean": 1.0, "level_mean": ""}
    rows = [{"timesteps": 1000.0 * i, "success_rate": i / 5 if i else "", **row} for i in range(5)]
    draw_curves({"run": rows}, tmp_path / "curve.png")
    assert (tmp_path / "curve.png").is_file()
    with pytest.raises(ValueError, match="no learning curve"):
        draw_curves({"run": []}, tmp_path / "none.png")


def test_ladder_has_a_row_of_panels_for_each_robot(tmp_path: Path) -> None:
    rows = [
        cell("oracle", direction, riser, 0.3, rate, robot=robot, policy=policy, condition=name, ci95=[rate / 2, 1.0])
        for robot in ("aliengo", "a1")
        for policy, rate in (("aliengo", 0.9), ("zero", 0.2))
        for direction in ("up", "down")
        for name, riser in (("rung", 0.15), ("rung", 0.2), ("steep", [0.18, 0.2]))
    ]
    draw_ladder(rows, tmp_path / "both.png")
    draw_ladder([row for row in rows if row["robot"] == "a1"], tmp_path / "one.png")
    both, one = iio.imread(tmp_path / "both.png"), iio.imread(tmp_path / "one.png")
    assert both.shape[0] == 2 * one.shape[0] and both[..., :3].std() > 10
    with pytest.raises(ValueError, match="ladder"):
        draw_ladder([], tmp_path / "none.png")
