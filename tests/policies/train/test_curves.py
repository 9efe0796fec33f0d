"""Learning curves of several seeds."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from policies.train.curves import compare_runs, read_curve


def write_run(folder: Path, seed: int, **settings: object) -> Path:
    folder.mkdir()
    (folder / "config.json").write_text(json.dumps({"seed": seed, "commit": "abc", "algorithm": "ppo", **settings}))
    header = "timesteps,wall_s,return_mean,success_rate,level_mean"
    (folder / "curve.csv").write_text(f"{header}\n100,1,5,,0\n200,2,7.5,0.{seed}5,1\n")
    return folder


def test_ends_and_curves_of_each_seed(tmp_path: Path) -> None:
    runs = [write_run(tmp_path / str(seed), seed) for seed in (3, 4)]
    results = compare_runs(runs)
    assert [row["seed"] for row in results["rows"]] == [3, 4]
    assert [row["success_rate_last"] for row in results["rows"]] == [0.35, 0.45]
    assert results["rows"][0]["return_mean_first"] == 5.0 and results["rows"][0]["timesteps"] == 200.0
    assert results["curves"][1]["success_rate"] == ["", 0.45] and results["algorithm"] == "ppo"
    assert json.loads(json.dumps(results)) == results


def test_runs_of_different_settings_are_refused(tmp_path: Path) -> None:
    runs = [write_run(tmp_path / "a", 0), write_run(tmp_path / "b", 1, algorithm="sac")]
    with pytest.raises(ValueError, match="b differs"):
        compare_runs(runs)


def test_trainings_that_differ_are_compared_by_name(tmp_path: Path) -> None:
    runs = {"one": write_run(tmp_path / "a", 0), "two": write_run(tmp_path / "b", 1, env_id="other")}
    results = compare_runs(runs)
    assert [(row["name"], row["env_id"]) for row in results["rows"]] == [("one", None), ("two", "other")]
    assert [curve["name"] for curve in results["curves"]] == ["one", "two"] and "env_id" not in results


def test_a_folder_without_a_curve_is_named(tmp_path: Path) -> None:
    assert read_curve(tmp_path / "none.csv") == []
    with pytest.raises(ValueError, match="holds no curve"):
        compare_runs([tmp_path])
    with pytest.raises(ValueError, match="empty"):
        compare_runs([])
