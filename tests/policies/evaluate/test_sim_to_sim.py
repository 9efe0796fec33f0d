import json

import pytest

from policies.evaluate.sim_to_sim import GAIT_NAME, compare, main, read_cells
from policies.statistics import wilson_interval


def results(path, engine, outcomes, stairs="paper", source="oracle", seed=7, **cell):
    """A results file with one cell an outcome string, as `stair-env evaluate` writes it."""
    cells = [
        {"source": source, "direction": "up", "riser_height": 0.1 + k / 100, "tread_depth": 0.3, "outcomes": text}
        | cell
        for k, text in enumerate(outcomes)
    ]
    kwargs = {} if engine == "bullet" else {"engine": engine}
    head = {"policy": "aliengo", "robot": "aliengo", "stairs": stairs, "env_kwargs": kwargs, "seed": seed}
    path.write_text(json.dumps({**head, "cells": cells}))
    return path


def test_flights_of_one_seed_are_paired(tmp_path):
    files = [
        results(tmp_path / "b.json", "bullet", ["11101", "111"]),
        results(tmp_path / "m.json", "mujoco", ["1011", "110"]),
    ]
    (row,) = compare(cell for path in files for cell in read_cells(path))
    assert row["episodes"] == 7 and (row["bullet"], row["mujoco"]) == (6, 5)
    assert (row["lost"], row["gained"]) == (2, 1) and row["stairs"] == "paper"
    assert row["mujoco_ci95"] == pytest.approx(list(wilson_interval(5, 7)))


def test_rungs_are_rows_of_their_own_and_gaits_have_a_name(tmp_path):
    files = [
        results(tmp_path / f"{engine}.json", engine, ["11", "10"], "ladder", "gait", condition="rung")
        for engine in ("bullet", "mujoco")
    ]
    rows = compare(cell for path in files for cell in read_cells(path))
    assert [row["stairs"] for row in rows] == ["riser 0.10 m", "riser 0.11 m"]
    assert {row["policy"] for row in rows} == {GAIT_NAME} and all(row["lost"] == row["gained"] == 0 for row in rows)


def test_other_seeds_are_not_paired(tmp_path, capsys):
    files = [
        results(tmp_path / "b.json", "bullet", ["11"], seed=1),
        results(tmp_path / "m.json", "mujoco", ["11"], seed=2),
    ]
    assert compare(cell for path in files for cell in read_cells(path)) == []
    with pytest.raises(SystemExit):
        main([str(tmp_path / "out.json"), *map(str, files)])
    assert "both engines" in capsys.readouterr().err and not (tmp_path / "out.json").exists()


def test_the_table_is_written(tmp_path):
    files = [results(tmp_path / f"{engine}.json", engine, ["11", "01"]) for engine in ("bullet", "mujoco")]
    assert main([str(tmp_path / "out.json"), *map(str, files)]) == 0
    written = json.loads((tmp_path / "out.json").read_text())
    assert written["rows"][0]["mujoco"] == 3 and written["seed"] == 7 and "commit" in written


@pytest.mark.parametrize("text", ["{", "[]", '{"cells": 3}', '{"cells": [{"source": "oracle"}], "policy": "aliengo"}'])
def test_what_is_no_results_file_is_named(tmp_path, text):
    path = tmp_path / "wrong.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"wrong\.json"):
        read_cells(path)
