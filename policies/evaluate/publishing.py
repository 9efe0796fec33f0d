"""A policy as a folder for the Hugging Face hub, in huggingface_sb3's layout, and its flights as a Minari data set.

Nothing is uploaded: `huggingface-cli upload NAME FOLDER` does that.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from policies import pretrained
from policies.evaluate.demo_flights import DemoConfig, run_demo
from policies.make_env import CLIMB_ID, make_env
from policies.rollout import Episode, run_episode
from policies.train.cards import PAGE_FILE, write_card
from stair_env.common.field_kinds import naming_fields
from stair_env.common.files import atomic_path, provenance, write_json

TRAINING_ONLY = ("curriculum", "randomization", "spawn", "stair_source", "privileged")  # of an environment's arguments
FILMED = ("actuation", "actuator", "observations", "gait")  # of them, what the film's environment needs too
FILM_FILE, RESULTS_FILE, CONFIG_FILE = "replay.mp4", "results.json", "config.json"
DATASET_NAME = re.compile(r"(?:[\w-]+/)*[\w-]+-v\d+")


@dataclass(frozen=True)
class PublishConfig:
    """What goes into the folder.

    Args:
        policy: shipped name, folder or file.
        episodes: flights that `results.json` reports, on the oracle's block.
        film: whether to film flights on what the camera sees.
        evaluations: JSON files of `stair-env evaluate` for the card.
        minari: name of a Minari data set of the flights, such as "stairs/aliengo-v0"; None writes none.
        seed: of the flights.

    Raises:
        ValueError: a value is out of range.
    """

    policy: str
    episodes: int = 10
    film: bool = True
    evaluations: Sequence[Path] = ()
    minari: str | None = None
    seed: int = 0

    @naming_fields
    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise ValueError(f"episodes={self.episodes!r} must be >= 1")
        if self.minari is not None and not DATASET_NAME.fullmatch(self.minari):
            raise ValueError(f"minari={self.minari!r} must be a name like 'stairs/aliengo-v0'")


def publish(config: PublishConfig, folder: Path, on_flight: Callable[[], None] = lambda: None) -> dict[str, Any]:
    """Write the folder.

    Args:
        config: what to publish.
        folder: is made; files of the same names are replaced.
        on_flight: called after each flight.

    Returns:
        The content of `results.json`, with `files` that were written.

    Raises:
        ValueError: no such policy (`policies.pretrained.PolicyError`), or an evaluation that is none.
        MissingExtraError: a data set is wanted, and Minari is not installed.
    """
    loaded = pretrained.load(config.policy)
    contents = pretrained.read_files(config.policy)
    card = dict(loaded.card)
    env_id = str(card.get("env_id", CLIMB_ID))
    kwargs = {key: value for key, value in dict(card.get("env_kwargs", {})).items() if key not in TRAINING_ONLY}
    episodes = _fly(config, env_id, kwargs, loaded, folder, on_flight)
    returns = [episode.total_reward for episode in episodes]
    results = {
        "mean_reward": float(np.mean(returns)),
        "std_reward": float(np.std(returns)),
        "success_rate": sum(episode.success for episode in episodes) / len(episodes),
        "is_deterministic": True,
        "n_eval_episodes": len(episodes),
        "eval_datetime": provenance(config.seed)["date"],
    }
    folder.mkdir(parents=True, exist_ok=True)
    algorithm = str(card.get("algorithm") or loaded.algorithm).lower()
    names = {pretrained.MODEL_FILE: f"{algorithm}-{env_id.split('/')[-1]}.zip"}
    names[pretrained.NORMALISATION_FILE] = pretrained.HUB_NORMALISATION_FILE
    for file, content in contents.items():
        with atomic_path(folder / names.get(file, file)) as temporary:
            temporary.write_bytes(content)
    write_json(folder / CONFIG_FILE, {**card, "env_id": env_id, "env_kwargs": kwargs}, seed=config.seed)
    write_json(folder / RESULTS_FILE, results, seed=config.seed)
    if config.film:
        _film(config, kwargs, folder)
    _write_page(config, folder, card, env_id, algorithm, results, names[pretrained.MODEL_FILE])
    return {**results, "files": sorted(path.name for path in folder.iterdir())}


def _fly(
    config: PublishConfig,
    env_id: str,
    kwargs: Mapping[str, Any],
    policy: pretrained.Policy,
    folder: Path,
    on_flight: Callable[[], None],
) -> list[Episode]:
    """Flights on the oracle's block, recorded where that is wanted."""
    seeds = np.random.SeedSequence(config.seed).generate_state(config.episodes)
    env = make_env(env_id, dict(kwargs), monitor=False)
    if config.minari is not None:
        env = _recorded(env, folder)
    try:
        policy.check_spaces(env)
        episodes = []
        for seed in seeds:
            episodes.append(run_episode(env, policy, int(seed)))
            on_flight()
        if config.minari is not None:
            env.create_dataset(  # type: ignore[attr-defined]
                config.minari, algorithm_name=policy.name, description=f"{policy.name} climbs stairs", eval_env=None
            )
    finally:
        env.close()
    return episodes


def _recorded(env: gym.Env, folder: Path) -> gym.Env:
    """The environment under Minari's collector, which writes into the folder."""
    from stair_env.common.importing.extras import naming_extras

    os.environ["MINARI_DATASETS_PATH"] = str((folder / "minari").resolve())
    with naming_extras():
        import minari

    collector: gym.Env = minari.DataCollector(env, record_infos=True)
    return collector


def _film(config: PublishConfig, kwargs: Mapping[str, Any], folder: Path) -> None:
    shown = {key: value for key, value in kwargs.items() if key in FILMED}
    demo = DemoConfig(
        policy=config.policy, robot=kwargs.get("robot", "aliengo"), episodes=2, seed=config.seed, env_kwargs=shown
    )
    with tempfile.TemporaryDirectory() as scratch:
        film = Path(run_demo(demo, scratch)["video"])
        with atomic_path(folder / FILM_FILE) as temporary:
            temporary.write_bytes(film.read_bytes())


def _write_page(
    config: PublishConfig,
    folder: Path,
    card: Mapping[str, Any],
    env_id: str,
    algorithm: str,
    results: Mapping[str, Any],
    model: str,
) -> None:
    """README.md: the hub's metadata, then the policy's own card."""
    import yaml

    source = pretrained.locate(config.policy)
    own_page = source / PAGE_FILE
    name = Path(config.policy).name
    if own_page.is_file() and not config.evaluations:
        body = own_page.read_text(encoding="utf-8")
        for picture in re.findall(r"!\[[^\]]*\]\(([\w.-]+)\)", body):
            if (source / picture).is_file():
                with atomic_path(folder / picture) as temporary:
                    temporary.write_bytes((source / picture).read_bytes())
    else:
        body = write_card(folder, name, card, None, config.evaluations).read_text(encoding="utf-8")
    reward = f"{results['mean_reward']:.2f} +/- {results['std_reward']:.2f}"
    environment = {"name": env_id, "type": env_id}
    metrics = [
        {"type": "mean_reward", "value": reward, "name": "mean_reward", "verified": False},
        {"type": "success_rate", "value": round(results["success_rate"], 3), "name": "success_rate", "verified": False},
    ]
    task = {"type": "reinforcement-learning", "name": "reinforcement-learning"}
    head = {
        "library_name": "stable-baselines3",
        "license": "mit",
        "tags": [env_id, "deep-reinforcement-learning", "reinforcement-learning", "stable-baselines3", "stair_env"],
        "model-index": [
            {"name": algorithm.upper(), "results": [{"task": task, "dataset": environment, "metrics": metrics}]}
        ],
    }
    robot = dict(card.get("env_kwargs", {})).get("robot", "aliengo")
    usage = (
        "\n## Use\n\n```python\nimport gymnasium as gym\n\nimport stair_env\nfrom policies import pretrained\n\n"
        f"env = gym.make({env_id!r}, robot={robot!r})\n"
        f"policy = pretrained.load({model!r}, env)\n```\n"
    )
    text = f"---\n{yaml.safe_dump(head, sort_keys=False)}---\n\n{body.rstrip()}\n{usage}"
    with atomic_path(folder / PAGE_FILE) as temporary:
        temporary.write_text(text, encoding="utf-8")
