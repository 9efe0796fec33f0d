"""A package of one's own called like one of ours: a named error says which file is in the way."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from stair_env.common.importing.shadowing import ROOT, check_sibling, import_sibling

MAKE = "import gymnasium as gym, stair_env; gym.make('stair_env/StairClimbPerception-v0')"
USES = {
    "perception": [MAKE, "import stair_env, perception.estimator", "import stair_env; from perception import wrapper"],
    "policies": ["import stair_env, policies.make_env", "import stair_env; from policies import pretrained"],
}


def run_script(folder: Path) -> subprocess.CompletedProcess:
    """Run it as from an installed wheel; -S leaves out the finder that a checkout installed for editing brings."""
    environment = {"PYTHONPATH": os.pathsep.join([str(ROOT), sysconfig.get_path("purelib")]), "PATH": ""}
    command = [sys.executable, "-S", "script.py"]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment, check=False)


@pytest.mark.parametrize("kind", ["package", "module"])
@pytest.mark.parametrize(("name", "code"), [(name, code) for name, codes in USES.items() for code in codes])
def test_the_file_in_the_way_is_named(name: str, code: str, kind: str, tmp_path: Path) -> None:
    hider = tmp_path / name / "__init__.py" if kind == "package" else tmp_path / f"{name}.py"
    hider.parent.mkdir(exist_ok=True)
    hider.write_text('"""My robot\'s own code."""\n')
    if kind == "module" and code != MAKE:
        pytest.skip("Python itself says that a module is no package, and asks nobody")
    (tmp_path / "script.py").write_text(code)
    done = run_script(tmp_path)
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 1 and "ShadowedPackageError" in last
    assert str(hider) in last and str(ROOT / name) in last and "rename" in last


def test_a_folder_without_a_package_hides_nothing(tmp_path: Path) -> None:
    (tmp_path / "perception").mkdir()
    (tmp_path / "script.py").write_text("import stair_env, perception.geometry.results; print('found')")
    done = run_script(tmp_path)
    assert done.stdout == "found\n", done.stderr


def test_ours_are_found() -> None:
    for name in ("perception", "policies", "stair_env_cli"):
        check_sibling(name)
    assert import_sibling("perception.geometry.results").__name__ == "perception.geometry.results"
