"""`stair-env train` and `stair-env evaluate` from the outside."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from stair_env_cli.main import main

TRAIN = ["train", "--vec", "dummy", "--num-envs", "1", "--set", '{"n_steps": 64, "batch_size": 64, "n_epochs": 1}']


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy trained for a moment."""
    folder = tmp_path_factory.mktemp("train") / "run"
    assert main([*TRAIN, "--timesteps", "128", "--checkpoint-every", "64", "--output", str(folder)]) == 0
    return folder


def test_train_writes_a_policy_and_goes_on(run_folder: Path, tmp_path: Path) -> None:
    card = json.loads((run_folder / "final" / "card.json").read_text())
    assert card["timesteps"] == 128 and card["env_kwargs"] == {"direction": "both", "curriculum": True}
    assert (
        main(["train", "--resume", "--timesteps", "192", "--output", str(run_folder), "--json", str(tmp_path / "c")])
        == 0
    )
    assert json.loads((tmp_path / "c").read_text())["timesteps"] == 192


def test_a_student_of_the_gait_is_evaluated_like_any_policy(tmp_path: Path) -> None:
    little = '{"rounds": 1, "steps_per_round": 40, "updates": 3, "net_arch": [16]}'
    options = ["--teacher", "gait", "--vec", "dummy", "--num-envs", "2", "--output", str(tmp_path / "run")]
    assert main(["train", *options, "--set", little, "--json", str(tmp_path / "card.json")]) == 0
    card = json.loads((tmp_path / "card.json").read_text())
    assert card["timesteps"] == 40 and card["env_kwargs"]["actuation"] == "joint"
    flights = ["--policy", str(tmp_path / "run/final"), "--source", "oracle,shuffled", "--stairs", "random"]
    limits = ["--episodes", "1", "--workers", "1", "--env-kwargs", '{"max_episode_steps": 8}']
    assert main(["evaluate", *flights, *limits, "--json", str(tmp_path / "flights.json")]) == 0
    assert set(json.loads((tmp_path / "flights.json").read_text())["overall"]) == {"oracle", "shuffled"}


def test_evaluate_writes_cells_and_overall(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.json"
    options = ["--policy", str(run_folder / "final"), "--source", "oracle,noisy,gait", "--stairs", "random"]
    limits = ["--episodes", "1", "--workers", "1", "--env-kwargs", '{"max_episode_steps": 20}', "--seed", "3"]
    assert main(["evaluate", *options, *limits, "--json", str(out)]) == 0
    results = json.loads(out.read_text())
    assert len(results["cells"]) == 3 * 2 and set(results["overall"]) == {"oracle", "noisy", "gait"}
    assert results["seed"] == 3 and "rmse_mm" in results["overall"]["noisy"] and results["commit"]
    assert "oracle" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["evaluate", "--policy", "no/such/policy"], ["no/such/policy", "model.zip"]),
        (["evaluate", "--source", "gait", "--robot", "cat"], ["robot='cat'", "aliengo"]),
        (["evaluate", "--policy", "a1", "--robot", "aliengo"], ["robot='aliengo'", "policy 'a1'", "aliengo-blind"]),
        (["evaluate", "--env-kwargs", '{"engine": "ode"}'], ["engine='ode'", "mujoco"]),
        (["train", "--physics", "bullet", "--env-kwargs", '{"engine": "mujoco"}'], ["--physics bullet", "mujoco"]),
        (["benchmark", "no_such.json"], ["no_such.json"]),
        (["benchmark", "submit", "no_such.json"], ["no_such.json"]),
        (["benchmark", "submit"], ["submit [NAME=]FILE"]),
        (["benchmark", "--write", "no_such.json"], ["--write", "submit"]),
        (["evaluate", "--source", "gait", "--ray-address", "auto"], ["ray_address='auto'", "engine='ray'"]),
        (["evaluate", "--source", "gait", "--network-server"], ["network_server", "engine='ray'"]),
        (["bench", "--engine", "ray"], ["--engine ray", "--scale"]),
        (["train", "--engine", "rllib", "--rerun"], ["--rerun", "--engine local"]),
        (["train", "--engine", "rllib", "--teacher", "gait"], ["--teacher", "--engine local"]),
        (["train", "--ray-address", "auto"], ["ray_address='auto'", "engine='rllib'"]),
        (["train", "--robot", "cat"], ["robot='cat'", "aliengo"]),
        (["train", "--env", "stair_env/StairFall-v0"], ["StairFall-v0"]),
        (["train", "--hyperparams", "no_such.yml"], ["no_such.yml"]),
        (["train", "--teacher", "gait", "--set", '{"turns": 3}'], ["turns", "rounds"]),
        (["demo", "--policy", "no/such/policy"], ["no/such/policy"]),
    ],
)
def test_bad_input_is_one_clear_line(
    arguments: list[str], words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = [] if arguments[0] in ("evaluate", "benchmark", "bench") else ["--output", str(tmp_path / "run")]
    assert main([*arguments, *output]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("stair-env")]
    assert len(lines) == 1 and all(word in lines[0] for word in words)


@pytest.mark.parametrize("arguments", [["evaluate", "--source", "seeing"], ["train", "--env-kwargs", "[1]"]])
def test_wrong_options_name_the_choices(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2 and capsys.readouterr().err


def test_a_line_is_checked_and_then_joins_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results = Path(__file__).parents[2] / "results"
    table = json.loads((results / "benchmark.json").read_text())
    (tmp_path / "benchmark.json").write_text(json.dumps(table))
    submit = ["benchmark", "submit", f"mine={results / 'evaluate_ladder_a1.json'}", "--output", str(tmp_path)]
    assert main(submit) == 0
    assert "no fault found" in capsys.readouterr().out
    assert json.loads((tmp_path / "benchmark.json").read_text()) == table  # nothing is written unless asked for
    assert main([*submit, "--write"]) == 0
    assert "| mine | oracle |" in (tmp_path / "benchmark.md").read_text()
    assert main(submit) == 2  # the name is taken now
    assert "policy: 'mine' is taken" in capsys.readouterr().err


def test_a_row_of_ones_own_joins_the_benchmark(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The gait alone for two control steps a flight: what counts is that the table takes it."""
    own = tmp_path / "own.json"
    options = ["--stairs", "ladder", "--source", "gait", "--direction", "up", "--episodes", "1", "--workers", "1"]
    limits = ["--env-kwargs", '{"max_episode_steps": 2}', "--figure", str(tmp_path / "own.png")]
    assert main(["evaluate", *options, *limits, "--json", str(own)]) == 0
    assert "push_1.0" in capsys.readouterr().out and (tmp_path / "own.png").stat().st_size > 1000
    assert main(["benchmark", str(own), "--output", str(tmp_path / "results")]) == 0
    assert main(["benchmark", str(own), "--output", str(tmp_path / "results")]) == 0  # once more changes nothing
    rows = json.loads((tmp_path / "results" / "benchmark.json").read_text())["cells"]
    assert len(rows) == 8 and {row["policy"] for row in rows} == {"zero"}
    assert '| zero {"max_episode_steps": 2} |' in (tmp_path / "results" / "benchmark.md").read_text()
    assert (tmp_path / "results" / "benchmark.png").is_file()


def test_flights_in_mujoco_say_so(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'stair-env[mujoco]'")
    flights = ["--policy", "aliengo", "--source", "oracle", "--stairs", "random", "--direction", "up"]
    limits = ["--episodes", "1", "--workers", "1", "--env-kwargs", '{"max_episode_steps": 3}']
    assert main(["evaluate", "--physics", "mujoco", *flights, *limits, "--json", str(tmp_path / "out.json")]) == 0
    assert json.loads((tmp_path / "out.json").read_text())["env_kwargs"] == {"max_episode_steps": 3, "engine": "mujoco"}


def test_the_default_engine_leaves_no_trace(tmp_path: Path) -> None:
    flights = ["--source", "gait", "--stairs", "random", "--direction", "up", "--episodes", "1", "--workers", "1"]
    limits = ["--env-kwargs", '{"max_episode_steps": 3}', "--json", str(tmp_path / "out.json")]
    assert main(["evaluate", "--physics", "bullet", *flights, *limits]) == 0
    assert json.loads((tmp_path / "out.json").read_text())["env_kwargs"] == {"max_episode_steps": 3}


def test_a_policy_learns_in_mujoco(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'stair-env[mujoco]'")
    options = ["--physics", "mujoco", "--timesteps", "64", "--output", str(tmp_path / "run")]
    assert main([*TRAIN, *options]) == 0
    assert json.loads((tmp_path / "run/final/card.json").read_text())["env_kwargs"]["engine"] == "mujoco"
