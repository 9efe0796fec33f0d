"""The comparison of sources: paired, reproducible, counted correctly."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from policies.evaluate.evaluation import (
    SOURCE_SETUPS,
    EvaluationConfig,
    count_episodes,
    episode_seeds,
    evaluate,
    film_chosen,
    plan_jobs,
    run_all,
    summarise,
)
from policies.evaluate.stair_sets import make_cells
from policies.make_env import CLIMB_ID, make_env
from policies.report.film import HOLD_FRAMES
from policies.rollout import Episode, ZeroAction, run_episode
from stair_env.common.constants import EVALUATION_SOURCES

ERRORS_MM2 = {"width": 50.0, "height": 200.0, "distance": 0.0, "same_edge_distance": 225.0}
SHORT = {"max_episode_steps": 20}


def episode(**changes: Any) -> Episode:
    plain = Episode(
        seed=0,
        success=True,
        steps_climbed=6,
        num_steps=6,
        control_steps=480,
        total_reward=1.0,
        termination="success",
        distance_m=2.0,
        energy_j=400.0,
        riser_hits=3,
        seen=100,
        measured=50,
        same_edge=25,
        squared_error_mm2=ERRORS_MM2,
    )
    return dataclasses.replace(plain, **changes)


def test_gait_evaluation_fills_every_cell() -> None:
    config = EvaluationConfig(sources=("gait",), stairs="paper", directions=("up",), episodes=2, env_kwargs=SHORT)
    done: list[int] = []
    results = evaluate(config, done.append)
    assert sum(done) == count_episodes(config) == 12
    assert len(results["cells"]) == 6 and set(results["overall"]) == {"gait"}
    for cell in results["cells"]:
        assert cell["episodes"] == 2 and cell["terminations"] == {"time_limit": 2}
        assert cell["ci95"][0] <= cell["success_rate"] <= cell["ci95"][1]
        assert "rmse_mm" not in cell


def test_perceived_sources_report_their_errors() -> None:
    config = EvaluationConfig(policy=None, sources=("gait",), stairs="random", episodes=1, env_kwargs=SHORT)
    with pytest.raises(ValueError, match="policy=None"):
        dataclasses.replace(config, sources=("noisy",))
    env = make_env(CLIMB_ID, {"stair_source": "noisy", **SHORT}, monitor=False)
    result = run_episode(env, ZeroAction(env.action_space), 0)
    env.close()
    assert 0 < result.measured <= result.seen <= 20
    summary = summarise([result], perceived=True, mass_kg=20.0)
    assert 0.0 < summary["rmse_mm"]["width"] < 60.0


def test_oracle_measures_without_error() -> None:
    env = make_env(CLIMB_ID, SHORT, monitor=False)
    result = run_episode(env, ZeroAction(env.action_space), 3)
    env.close()
    assert result.measured == result.seen > 0
    assert max(result.squared_error_mm2.values()) / result.seen < 1e-3


def test_sources_share_their_episodes() -> None:
    """Same staircase, start and body for each source: the pairs are pairs."""
    starts = []
    for name in ("oracle", "noisy", "blind", "shuffled"):
        env = make_env(CLIMB_ID, {"direction": "both", **SOURCE_SETUPS[name].env_kwargs}, monitor=False)
        observation, info = env.reset(seed=5)
        truth = info["truth"]
        starts.append(
            [truth["riser_height"], truth["tread_depth"], truth["num_steps"], *truth["position"], truth["yaw"]]
        )
        starts[-1].extend(observation["proprio"][:9])
        env.close()
    assert np.ptp(np.array(starts), axis=0).max() == 0.0


def test_jobs_cover_each_pair_once() -> None:
    config = EvaluationConfig("p", "b", sources=EVALUATION_SOURCES, stairs="grid", episodes=7)
    cells = make_cells("grid")
    jobs = plan_jobs(config, cells)
    assert jobs[0].source == "stairnet"
    for source in EVALUATION_SOURCES:
        for index in range(len(cells)):
            seeds = [seed for job in jobs if (job.source, job.cell_index) == (source, index) for seed in job.seeds]
            assert seeds == episode_seeds(0, index, 7)
    assert {job.policy for job in jobs if job.source == "blind"} == {"b"}
    assert {job.policy for job in jobs if job.source == "gait"} == {None}


def test_more_episodes_keep_the_first_ones() -> None:
    assert episode_seeds(1, 2, 50)[:10] == episode_seeds(1, 2, 10)
    assert len(set(episode_seeds(1, 2, 50)) | set(episode_seeds(1, 3, 50)) | set(episode_seeds(2, 2, 50))) == 150


def test_summary_counts() -> None:
    failed = episode(success=False, steps_climbed=3, termination="fall", riser_hits=6)
    summary = summarise([episode(), failed], perceived=True, mass_kg=20.0)
    assert summary["successes"] == 1 and summary["success_rate"] == 0.5
    assert summary["steps_climbed_fraction"] == 9 / 12
    assert summary["riser_hits_per_step"] == 1.0
    assert summary["time_s"] == pytest.approx(10.0)
    assert summary["terminations"] == {"fall": 1, "success": 1}
    assert summary["valid_fraction"] == 0.5
    assert summary["rmse_mm"] == {"width": 1.0, "height": 2.0, "distance": 0.0, "same_edge_distance": 3.0}
    assert summary["same_edge_fraction"] == 0.5
    assert summary["cost_of_transport"] == pytest.approx(800.0 / (20.0 * 9.81 * 4.0))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"sources": ("seeing",)}, "'oracle'"),
        ({"sources": ()}, "sources"),
        ({"episodes": 0}, "episodes=0"),
        ({"workers": -1}, "workers=-1"),
        ({"robot": "cat"}, "aliengo"),
        ({"sources": ("blind",)}, "blind_policy"),
    ],
)
def test_wrong_configuration_is_named(change: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        EvaluationConfig(**{"sources": ("gait",), **change})


def test_film_shows_the_episodes_that_were_counted(tmp_path: Path) -> None:
    import imageio.v2 as imageio

    config = EvaluationConfig(sources=("gait",), stairs="random", directions=("up",), episodes=2, env_kwargs=SHORT)
    records = run_all(config)
    videos = film_chosen(config, records, tmp_path)
    assert [path.name for path in videos] == ["gait_failure.mp4"]
    with imageio.get_reader(videos[0]) as reader:
        assert reader.count_frames() == 6 + HOLD_FRAMES  # steps 0, 4 .. 20, then the outcome


@pytest.mark.slow
def test_workers_and_one_process_agree() -> None:
    config = EvaluationConfig(sources=("gait",), stairs="random", episodes=6, env_kwargs=SHORT)
    assert evaluate(config) == evaluate(dataclasses.replace(config, workers=2))


def test_ladder_rows_name_their_condition_and_each_outcome() -> None:
    limits = {"max_episode_steps": 2}
    config = EvaluationConfig(
        policy="random", sources=("oracle",), stairs="ladder", directions=("up",), episodes=1, env_kwargs=limits
    )
    cells = evaluate(config)["cells"]
    assert [cell["riser_height"] for cell in cells if cell["condition"] == "rung"] == [0.15, 0.17, 0.20, 0.23]
    assert {cell["outcomes"] for cell in cells} == {"0"}


def test_a_policy_brings_its_robot_and_refuses_another() -> None:
    config = EvaluationConfig(policy="a1", sources=("oracle",), stairs="ladder", directions=("up",))
    assert config.robot == "a1" and config.cells()[0].riser_height == 0.12
    assert {job.env_kwargs["robot"] for job in plan_jobs(config, config.cells())} == {"a1"}
    assert EvaluationConfig(sources=("gait",)).robot == "aliengo"
    with pytest.raises(ValueError, match=r"robot='aliengo': policy 'a1' was trained on 'a1'.*aliengo, aliengo-blind"):
        dataclasses.replace(config, robot="aliengo")
