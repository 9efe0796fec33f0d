"""Episodes on disk: a long evaluation survives a kill."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from policies.evaluate.episode_log import EpisodeLog, log_path
from policies.evaluate.evaluation import EvaluationConfig, episode_settings, evaluate, run_all, tabulate

CONFIG = EvaluationConfig(
    sources=("gait",), stairs="random", directions=("up",), episodes=7, env_kwargs={"max_episode_steps": 8}
)


def open_log(path: Path, config: EvaluationConfig = CONFIG, resume: bool = True) -> EpisodeLog:
    return EpisodeLog(path, episode_settings(config), resume=resume)


def test_a_killed_evaluation_goes_on(tmp_path: Path) -> None:
    path = log_path(tmp_path / "results.json")
    whole = evaluate(CONFIG)
    run_all(dataclasses.replace(CONFIG, episodes=5), log=open_log(path))
    with path.open("a") as file:
        file.write('{"source": "gait", "po')  # what a kill leaves
    new: list[int] = []
    records = run_all(CONFIG, new.append, open_log(path))
    assert tabulate(CONFIG, records) == whole
    assert new == [5, 2]  # what was there, then what was run
    again: list[int] = []
    run_all(CONFIG, again.append, open_log(path))
    assert again == [7]


def test_without_resume_it_begins_anew(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    run_all(dataclasses.replace(CONFIG, episodes=1), log=open_log(path))
    assert len(open_log(path).episodes) == 1
    assert not open_log(path, resume=False).episodes


def test_another_policy_has_episodes_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    log = open_log(path)
    episodes = run_all(dataclasses.replace(CONFIG, episodes=1))["gait", 0]
    log.add("oracle", "aliengo", 0, episodes)
    log.add("oracle", "other", 0, episodes)
    assert len(open_log(path).episodes) == 2


def test_other_settings_are_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    open_log(path)
    with pytest.raises(ValueError, match="lighting='day', now 'night'"):
        open_log(path, dataclasses.replace(CONFIG, lighting="night"))


@pytest.mark.parametrize("text", ["no json\n", "[]\n", '{"settings": {}}\n{"source": "gait"}\n'])
def test_another_file_is_refused_by_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "b.jsonl"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"b\.jsonl is no log"):
        open_log(path)
    assert path.read_text() == text
