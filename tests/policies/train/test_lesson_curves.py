"""Curves of learning from a teacher."""

from __future__ import annotations

from pathlib import Path

import pytest

from policies.report.figures import draw_imitation
from policies.train.cards import write_card
from policies.train.curves import WINDOW
from policies.train.imitation.lesson_curves import _main, read_runs, read_table


def write_run(folder: Path, flights: list[tuple[int, int]]) -> Path:
    folder.mkdir()
    rows = [f"{100 * (i + 1)},0.5,{flown},{arrived},{i}" for i, (flown, arrived) in enumerate(flights)]
    (folder / "curve.csv").write_text("\n".join(["timesteps,loss,alone_episodes,alone_successes,wall_s", *rows]) + "\n")
    return folder


def test_rates_count_the_flights_of_a_window(tmp_path: Path) -> None:
    curves = read_runs({"one": write_run(tmp_path / "a", [(0, 0), (4, 0), (4, 4), (2, 2), (10, 5)])})
    rates = [row["alone_rate"] for row in curves["one"]]
    assert WINDOW == 3 and rates == [None, 0.0, 0.5, 0.6, 11 / 16]
    low, high = curves["one"][-1]["alone_ci95"]
    assert 0.0 < low < 11 / 16 < high < 1.0
    draw_imitation(curves, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 1000


def test_runs_that_are_gone_stay_in_the_figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = (write_run(tmp_path / name, [(2, 1), (3, arrived)]) for name, arrived in (("a", 1), ("b", 2)))
    files = [str(tmp_path / "one.json"), "--figure", str(tmp_path / "curves.png")]
    monkeypatch.setattr("sys.argv", ["lesson_curves", f"one={first}", "--output", *files])
    _main()
    again = ["lesson_curves", f"two={second}", "--beside", files[0], "--output", str(tmp_path / "both.json")]
    monkeypatch.setattr("sys.argv", [*again, *files[1:]])
    _main()
    assert read_table(tmp_path / "both.json") == read_runs({"one": first, "two": second})
    (tmp_path / "other.json").write_text('{"curves": 3}')
    with pytest.raises(ValueError, match=r"other\.json is no output of policies\.train\.imitation\.lesson_curves"):
        read_table(tmp_path / "other.json")


def test_other_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"holds no curve\.csv with timesteps"):
        read_runs({"none": tmp_path})


def test_a_model_card_shows_the_curve(tmp_path: Path) -> None:
    run = write_run(tmp_path / "a", [(0, 0), (4, 2)])
    card = {"method": "dagger", "training": {"alone_episodes": 4, "success_rate": 0.5}}
    page = write_card(tmp_path, "mine", card, run / "curve.csv").read_text()
    assert "- success rate of the flights alone in the last round: 0.5" in page and "(curve.png)" in page
    assert (tmp_path / "curve.png").is_file()
