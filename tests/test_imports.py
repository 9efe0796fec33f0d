"""Imports follow the flow of the data (docs/architecture.md), and the light packages stay light."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("stair_env", "perception", "policies")
HEAVY = ("torch", "numba", "matplotlib", "stable_baselines3", "lightning", "onnxruntime", "cv2")

# Lower numbers come first in the flow; a module reaches only its own level and below. Modules that the flow does not
# name (robots, textures, kinematics ...) may stand anywhere, as long as they carry no arrow back.
LEVELS = {
    "stair_env.stairs": 0,
    "stair_env.scene": 1,
    "stair_env.appearance": 2,
    "stair_env.distractors": 2,
    "stair_env.sampling": 3,
    "stair_env.camera": 4,
    "stair_env.imu": 4,
    "stair_env.observation": 5,
    "stair_env.env": 6,
    "stair_env.wrappers": 8,
    "perception": 7,
    "policies": 9,
    "stair_env.cli": 10,
}


def level_of(module: str) -> int | None:
    parts = module.split(".")
    prefixes = (".".join(parts[:n]) for n in range(len(parts), 0, -1))
    return next((LEVELS[prefix] for prefix in prefixes if prefix in LEVELS), None)


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def all_modules() -> dict[str, Path]:
    return {module_name(path): path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))}


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def walk_runtime(node: ast.AST) -> Iterator[ast.AST]:
    """Every node that can run; imports under TYPE_CHECKING never do."""
    for child in ast.iter_child_nodes(node):
        if is_type_checking(child):
            continue
        yield child
        yield from walk_runtime(child)


def imported_names(tree: ast.AST, module: str, is_package: bool) -> set[str]:
    found: set[str] = set()
    for node in walk_runtime(tree):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = module.split(".")[: len(module.split(".")) - node.level + is_package]
                base = ".".join([*parents, base] if base else parents)
            found.update(f"{base}.{alias.name}" for alias in node.names)
    return found


def import_graph() -> dict[str, set[str]]:
    """Project module -> project modules it imports anywhere, also inside functions."""
    modules = all_modules()
    graph: dict[str, set[str]] = {}
    for name, path in modules.items():
        names = imported_names(ast.parse(path.read_text()), name, path.name == "__init__.py")
        targets = {full if full in modules else full.rpartition(".")[0] for full in names}
        graph[name] = {target for target in targets if target in modules} - {name}
    return graph


GRAPH = import_graph()


def reachable(module: str) -> set[str]:
    """Everything that a module imports, directly or through others."""
    found: set[str] = set()
    waiting = [module]
    while waiting:
        new = GRAPH[waiting.pop()] - found
        found |= new
        waiting.extend(new)
    return found


def runs_backwards(module: str, target: str) -> bool:
    level, other = level_of(module), level_of(target)
    return level is not None and other is not None and other > level


@pytest.mark.parametrize("module", sorted(GRAPH))
def test_imports_never_run_against_the_flow(module: str) -> None:
    backwards = sorted(target for target in reachable(module) if runs_backwards(module, target))
    assert not backwards, f"{module} reaches {backwards}, which come later in the flow"


def test_stair_env_imports_neither_sibling() -> None:
    for module, targets in GRAPH.items():
        if module.startswith("stair_env") and not module.startswith("stair_env.cli"):
            assert not {target for target in targets if target.split(".")[0] != "stair_env"}, module


def test_imports_make_no_circle() -> None:
    done: set[str] = set()

    def visit(module: str, trail: tuple[str, ...]) -> None:
        assert module not in trail, " -> ".join([*trail[trail.index(module) :], module])
        if module in done:
            return
        for target in sorted(GRAPH[module]):
            visit(target, (*trail, module))
        done.add(module)

    for module in GRAPH:
        visit(module, ())


def test_a_backward_import_is_found() -> None:
    text = "def late():\n    from perception import estimator\n    from . import env\n"
    names = imported_names(ast.parse(text), "stair_env.stairs", is_package=False)
    assert names == {"perception.estimator", "stair_env.env"}
    assert all(runs_backwards("stair_env.stairs", name) for name in names)


def loaded_after(code: str) -> set[str]:
    script = f"{code}\nimport sys, json\nprint(json.dumps(sorted({{name.split('.')[0] for name in sys.modules}})))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.parametrize(
    "code",
    [
        "import stair_env",
        "import perception, policies",
        "from stair_env.cli.main import main\ntry:\n    main(['--help'])\nexcept SystemExit:\n    pass",
    ],
)
def test_light_entry_points_load_nothing_heavy(code: str) -> None:
    assert not loaded_after(code) & set(HEAVY)
