import builtins

import pytest

from policies.train.wandb_run import wandb_run
from stair_env.common.importing.extras import MissingExtraError


def test_nothing_is_followed_without_a_project(tmp_path):
    with wandb_run(None, tmp_path, {}):
        pass
    assert not list(tmp_path.iterdir())


def test_missing_library_names_its_extra(tmp_path, monkeypatch):
    found = builtins.__import__

    def without_wandb(name, *args, **kwargs):
        if name == "wandb":
            raise ModuleNotFoundError("No module named 'wandb'", name="wandb")
        return found(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_wandb)
    with pytest.raises(MissingExtraError, match="pip install wandb"), wandb_run("stairs", tmp_path, {}):
        pass


def test_offline_run_is_kept_and_gone_on_with(tmp_path, monkeypatch):
    pytest.importorskip("wandb", reason="pip install 'stair-env[wandb]'")
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    for _ in range(2):
        with wandb_run("stairs", tmp_path, {"seed": 0}):
            pass
    runs = list((tmp_path / "wandb").glob("offline-run-*"))
    assert runs
    assert len({path.name.rsplit("-", 1)[-1] for path in runs}) == 1
