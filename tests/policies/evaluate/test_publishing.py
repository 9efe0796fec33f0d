import json
import os

import numpy as np
import pytest
import yaml

from policies import pretrained
from policies.evaluate.publishing import PublishConfig, publish


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hub")
    results = publish(PublishConfig("aliengo", episodes=1, film=False), folder)
    return folder, results


def test_folder_has_the_hubs_layout(published):
    folder, results = published
    assert {"README.md", "config.json", "results.json", "ppo-StairClimb-v0.zip", "vec_normalize.pkl"} <= set(
        results["files"]
    )
    head = yaml.safe_load((folder / "README.md").read_text().split("---\n")[1])
    assert head["library_name"] == "stable-baselines3"
    metrics = head["model-index"][0]["results"][0]["metrics"]
    assert metrics[0]["type"] == "mean_reward"
    assert metrics[0]["value"].startswith(f"{results['mean_reward']:.2f}")
    assert json.loads((folder / "results.json").read_text())["n_eval_episodes"] == 1


def test_pictures_of_the_card_come_along(published):
    folder, _ = published
    text = (folder / "README.md").read_text()
    assert "curve.png" not in text or (folder / "curve.png").is_file()


def test_what_was_published_acts_as_the_policy_does(published):
    folder, _ = published
    ours, theirs = pretrained.load("aliengo"), pretrained.load(folder / "ppo-StairClimb-v0.zip")
    rng = np.random.default_rng(0)
    for _ in range(5):
        space = ours.model.observation_space
        observation = {key: rng.uniform(-1, 1, box.shape).astype(np.float32) for key, box in space.spaces.items()}
        assert np.array_equal(ours.predict(observation)[0], theirs.predict(observation)[0])


def test_flights_become_a_minari_data_set(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari", reason="pip install 'stair-env[minari]'")
    monkeypatch.setenv("MINARI_DATASETS_PATH", os.environ.get("MINARI_DATASETS_PATH", ""))
    publish(PublishConfig("aliengo", episodes=1, film=False, minari="stairs/aliengo-v0"), tmp_path)
    assert minari.load_dataset("stairs/aliengo-v0").total_episodes == 1


@pytest.mark.parametrize("wrong", [{"episodes": 0}, {"minari": "no version"}])
def test_wrong_arguments_are_named(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        PublishConfig("aliengo", **wrong)


def test_unknown_policy_leaves_no_folder(tmp_path):
    with pytest.raises(pretrained.PolicyError, match="nobody"):
        publish(PublishConfig("nobody"), tmp_path / "out")
    assert not (tmp_path / "out").exists()
