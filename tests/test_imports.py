"""Imports follow the flow of the data (docs/architecture.md), and the light packages stay light."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from stair_env_cli.main import COMMANDS

ROOT = Path(__file__).resolve().parents[1]
LIBRARIES = ("stair_env", "perception", "policies")  # their top level is what users import
PACKAGES = (*LIBRARIES, "stair_env_cli")
MAX_MODULES = 14  # in a folder; beyond that nobody finds anything
MAX_LINES = 400
HEAVY = ("torch", "numba", "matplotlib", "stable_baselines3", "lightning", "onnxruntime", "cv2")

# Rooms in the order of the flow, one level a line: a folder, or a module (at the top of a library, or where others of
# its folder build on it). A module imports only
# from its own room and from rooms of lower levels.
FLOW = (
    "stair_env.common.importing",
    "stair_env.common",
    "stair_env.common.tasks",
    "stair_env perception policies",  # the packages themselves, which register ids and let old paths work
    "stair_env.stairs",
    "stair_env.scene.shapes stair_env.scene.materials",
    "stair_env.scene.objects",
    "stair_env.scene stair_env.intrinsics",
    "stair_env.sampling stair_env.robots",
    "stair_env.sensors.camera.renderers stair_env.sensors.camera.noise_tiles",
    "stair_env.sensors.camera.stereo stair_env.sensors.camera.depth_model",
    "stair_env.sensors.camera stair_env.physics",
    "stair_env.sensors",
    "stair_env.observation",
    "stair_env.task.randomization",
    "stair_env.task.step_state",
    "stair_env.task.terms",
    "stair_env.onboard stair_env.task stair_env.vectorized",
    "stair_env.parts",
    "stair_env.env stair_env.vector",
    "stair_env.rgbd stair_env.entry_points stair_env.flat_info",
    "perception.grouped_convolution",
    "perception.network",
    "perception.geometry.line_kernels",
    "perception.geometry.lines",
    "perception.geometry.strips",
    "perception.geometry.profile",
    "perception.inference perception.geometry",
    "perception.tracking perception.estimator perception.drawing perception.lens",
    "perception.wrapper",
    "perception.vector_wrapper",
    "perception.gym_entry_points",
    "perception.data",
    "perception.sources",
    "perception.deploy",
    "perception.looking",
    "perception.learning",
    "perception.reproduction perception.reproduction.baselines",
    "perception.reproduction.tables_2_3_6",
    "policies.statistics policies.hyperparams policies.features policies.vec_adapter policies.saved_models",
    "policies.stances policies.portable policies.zoo policies.spaces",
    "policies.joint_level",
    "policies.rollout policies.make_env",
    "policies.report",
    "policies.train",
    "policies.train.imitation policies.train.rllib",
    "policies.pretrained",
    "policies.export_actor",
    "policies.evaluate policies.watch",
    "stair_env_cli",
    "stair_env_cli.bench",
)
LEVELS = {room: level for level, rooms in enumerate(FLOW) for room in rooms.split()}


def room_of(module: str) -> str:
    """The folder that a module lies in; at a package's top, and where the flow names it, the module itself."""
    if module in LEVELS:
        return module
    folder = module if MODULES[module].name == "__init__.py" else module.rpartition(".")[0]
    return module if folder in LIBRARIES else folder


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


def import_graph(modules: dict[str, Path]) -> dict[str, set[str]]:
    """Project module -> project modules it imports anywhere, also inside functions."""
    graph: dict[str, set[str]] = {}
    for name, path in modules.items():
        names = imported_names(ast.parse(path.read_text()), name, path.name == "__init__.py")
        targets = {full if full in modules else full.rpartition(".")[0] for full in names}
        graph[name] = {target for target in targets if target in modules} - {name}
    return graph


MODULES = all_modules()
GRAPH = import_graph(MODULES)


def runs_backwards(module: str, target: str) -> bool:
    room, other = room_of(module), room_of(target)
    return room != other and LEVELS[other] >= LEVELS[room]


def test_every_room_has_a_level() -> None:
    assert {room_of(module) for module in MODULES} == set(LEVELS)


@pytest.mark.parametrize("module", sorted(GRAPH))
def test_imports_never_run_against_the_flow(module: str) -> None:
    backwards = sorted(target for target in GRAPH[module] if runs_backwards(module, target))
    assert not backwards, f"{module} imports {backwards}, which come later in the flow"


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


def test_folders_stay_small() -> None:
    folders = Counter(path.parent for path in MODULES.values())
    commands = set(COMMANDS)
    folders[ROOT / "stair_env_cli"] -= sum(path.stem.replace("_", "-") in commands for path in MODULES.values())
    assert not {str(folder): count for folder, count in folders.items() if count > MAX_MODULES}


def test_files_stay_short() -> None:
    texts = {name: path.read_text() for name, path in MODULES.items()}
    # Compiled code stays in one file: numba's cache watches only the file that a function stands in.
    long = [name for name, text in texts.items() if text.count("\n") > MAX_LINES and "import njit" not in text]
    assert not long


def test_no_two_modules_have_one_name() -> None:
    names = Counter(path.stem for path in MODULES.values() if path.stem != "__init__")
    assert not [name for name, count in names.items() if count > 1]


def loaded_after(code: str) -> set[str]:
    script = f"{code}\nimport sys, json\nprint(json.dumps(sorted({{name.split('.')[0] for name in sys.modules}})))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.parametrize(
    "code",
    [
        "import stair_env",
        "import perception, policies",
        "from stair_env_cli.main import main\ntry:\n    main(['--help'])\nexcept SystemExit:\n    pass",
    ],
)
def test_light_entry_points_load_nothing_heavy(code: str) -> None:
    assert not loaded_after(code) & set(HEAVY)


def test_kernels_are_cached_outside_the_package() -> None:
    ours = "stair_env.common.compiling"
    strangers = [
        name for name, path in MODULES.items() if name != ours and "from numba import njit" in path.read_text()
    ]
    assert not strangers, f"{strangers} should import njit from {ours}"
