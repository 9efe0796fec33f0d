from __future__ import annotations

import importlib
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

import perception
import policies
import stair_env
from stair_env.common.moved import MOVED, new_path

# Paths that the documentation of 0.1 named, with a name that stood there.
DOCUMENTED = {
    "perception.attitude": "CameraAttitude",
    "perception.backends": "OnnxBackend",
    "perception.baselines.base": "LineDetector",
    "perception.baselines.runs": "SUITE_PRESET",
    "perception.dataset": "StairDataset",
    "perception.detector": "NetworkDetector",
    "perception.labels": "encode_grid",
    "perception.lines": "find_lines",
    "perception.losses": "total_loss",
    "perception.metrics": "count_cells",
    "perception.nosing_map": "NosingMap",
    "perception.preprocess": "letterbox",
    "perception.synthetic": "draw_frame",
    "perception.tracker": "StairTracker",
    "perception.training": "train",
    "perception.widening": "widened",
    "policies.curves": "read_curve",
    "policies.evaluation": "evaluate",
    "policies.training": "TrainingConfig",
    "stair_env.appearance": "AppearanceSpec",
    "stair_env.camera.depth_error": "DepthErrorModel",
    "stair_env.camera.intrinsics": "Intrinsics",
    "stair_env.camera.renderers": "make_renderer",
    "stair_env.camera.sensor": "RgbdCamera",
    "stair_env.cli.main": "main",
    "stair_env.distractors": "DistractorSpec",
    "stair_env.gait": "Gait",
    "stair_env.imu": "Imu",
    "stair_env.privileged": "PRIVILEGED_SLICES",
    "stair_env.provenance": "write_json",
    "stair_env.results_page": "write_page",
    "stair_env.scene_spec": "Scene",
    "stair_env.simulation": "Simulation",
    "stair_env.sources": "PerceptionErrorModel",
}


def run(code: str, *options: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *options, "-c", code], capture_output=True, text=True, cwd=cwd)


@pytest.mark.parametrize("old", sorted(MOVED))
def test_an_old_path_points_at_a_module_and_hides_none(old: str) -> None:
    assert importlib.util.find_spec(MOVED[old]) is not None
    assert MOVED[old] not in MOVED
    package = {"stair_env": stair_env, "perception": perception, "policies": policies}[old.partition(".")[0]]
    place = Path(next(iter(package.__path__))).joinpath(*old.split(".")[1:])
    assert not place.with_suffix(".py").exists() and not (place / "__init__.py").exists()


@pytest.mark.parametrize(("old", "name"), sorted(DOCUMENTED.items()))
def test_documented_paths_still_work(old: str, name: str) -> None:
    new = new_path(old)
    assert new is not None
    module = importlib.import_module(old)
    assert module is importlib.import_module(new)
    assert hasattr(module, name)


def test_an_old_path_warns_and_gives_the_same_module() -> None:
    code = (
        "import warnings, sys\n"
        "with warnings.catch_warnings(record=True) as caught:\n"
        "    warnings.simplefilter('always')\n"
        "    import perception.lines as old\n"
        "import perception.geometry.lines as new\n"
        "assert old is new and sys.modules['perception.lines'] is new and new.__spec__.name == new.__name__\n"
        "messages = [(str(w.message), w.category, w.filename) for w in caught]\n"
        "assert len(messages) == 1 and messages[0][1] is DeprecationWarning, messages\n"
        "assert 'perception.geometry.lines' in messages[0][0] and messages[0][2] == '<string>', messages\n"
    )
    done = run(code)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "line",
    [
        "from stair_env.camera import intrinsics; intrinsics.Intrinsics",
        "import stair_env.camera.renderers.base as base; base.Frame",
        "from stair_env.scene import Shape, build_stair_shapes",
        "from perception.geometry import measure_stairs",
        "import stair_env.camera.intrinsics; stair_env.camera.intrinsics.Intrinsics",
    ],
)
def test_every_form_of_import_works(line: str) -> None:
    done = run(line)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["perception.nonsense", "stair_env.camera.nonsense", "stair_env.scene.nonsense"])
def test_what_never_was_is_still_an_error(name: str) -> None:
    with pytest.raises(ModuleNotFoundError, match=name):
        importlib.import_module(name)


def test_modules_run_by_their_old_path() -> None:
    done = subprocess.run([sys.executable, "-m", "stair_env.cli.main", "--version"], capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.startswith("stair-env "), done.stderr


def test_a_package_of_the_same_name_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "perception").mkdir()
    (tmp_path / "perception" / "__init__.py").write_text("")
    (tmp_path / "perception" / "lines.py").write_text("MINE = True\n")
    done = run("import stair_env, perception.lines; assert perception.lines.MINE", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
