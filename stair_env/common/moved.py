"""Old import paths of modules that have moved: they work for one more release and say where to look.

`install` puts a finder before Python's own. It answers only for the names in `MOVED` (and below them) and only inside
the packages that asked for it, so that it never stands in the way of another module. What it hands out is the very
module of the new path, not a second copy: classes stay equal, and nothing is loaded before somebody asks.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
import warnings
from collections.abc import Callable, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import CodeType, ModuleType

MOVED: dict[str, str] = {
    "perception.attitude": "perception.tracking.camera_gravity",
    "perception.augmentation": "perception.data.augmentation",
    "perception.backends": "perception.inference.backends",
    "perception.baselines": "perception.reproduction.baselines",
    "perception.baselines.base": "perception.reproduction.baselines.line_detector",
    "perception.baselines.paper_figure": "perception.reproduction.tables_2_3_6.figure7",
    "perception.baselines.paper_suite": "perception.reproduction.tables_2_3_6.suite",
    "perception.baselines.paper_tables": "perception.reproduction.tables_2_3_6.tables",
    "perception.baselines.regions": "perception.reproduction.baselines.region_score",
    "perception.baselines.roi": "perception.reproduction.baselines.region_detector",
    "perception.baselines.roi_loss": "perception.reproduction.baselines.region_loss",
    "perception.baselines.roi_network": "perception.reproduction.baselines.region_network",
    "perception.baselines.runs": "perception.reproduction.tables_2_3_6.runs",
    "perception.baselines.suite": "perception.reproduction.tables_2_3_6.classical_suite",
    "perception.baselines.training": "perception.reproduction.baselines.baseline_training",
    "perception.baselines.tuning": "perception.reproduction.baselines.classical_tuning",
    "perception.dataset": "perception.data.stair_dataset",
    "perception.dataset_writer": "perception.data.writer",
    "perception.detector": "perception.inference.detector",
    "perception.drops": "perception.geometry.profile.depth_jumps",
    "perception.environment": "perception.gym_entry_points",
    "perception.estimate": "perception.geometry.results",
    "perception.evaluation": "perception.reproduction.table5_detection",
    "perception.face_kernels": "perception.geometry.strips.strip_kernels",
    "perception.face_kinds": "perception.geometry.strips.strip_labels",
    "perception.faces": "perception.geometry.strips.strip_planes",
    "perception.folding": "perception.inference.batchnorm_fusion",
    "perception.frame_files": "perception.data.frame_files",
    "perception.ideal": "perception.reproduction.ideal_detector",
    "perception.labels": "perception.data.label_grid",
    "perception.line_check": "perception.geometry.line_matching",
    "perception.line_kernels": "perception.geometry.line_kernels",
    "perception.lines": "perception.geometry.lines",
    "perception.live": "perception.reproduction.walking",
    "perception.losses": "perception.learning.losses",
    "perception.measure": "perception.reproduction.table7_geometry",
    "perception.metrics": "perception.learning.metrics",
    "perception.nosing_map": "perception.tracking.nosing_filter",
    "perception.odometry": "perception.tracking.pose_history",
    "perception.paper_geometry": "perception.geometry.paper",
    "perception.preprocess": "perception.inference.preprocess",
    "perception.profile": "perception.geometry.profile.depth_profile",
    "perception.profile_kernels": "perception.geometry.profile.depth_profile_kernels",
    "perception.section": "perception.geometry.cross_section",
    "perception.speed": "perception.reproduction.table4_speed",
    "perception.synthetic": "perception.data.synthetic",
    "perception.tracker": "perception.tracking.tracker",
    "perception.training": "perception.learning.network_training",
    "perception.weights_io": "perception.inference.weights",
    "perception.widening": "perception.learning.net2net",
    "policies.callbacks": "policies.train.callbacks",
    "policies.cards": "policies.train.cards",
    "policies.checkpoints": "policies.train.checkpoints",
    "policies.curves": "policies.train.curves",
    "policies.demo": "policies.evaluate.demo_flights",
    "policies.episode_log": "policies.evaluate.episode_log",
    "policies.evaluation": "policies.evaluate.evaluation",
    "policies.figures": "policies.report.figures",
    "policies.film": "policies.report.film",
    "policies.stair_sets": "policies.evaluate.stair_sets",
    "policies.training": "policies.train.training",
    "policies.video": "policies.report.film_layout",
    "stair_env.appearance": "stair_env.scene.appearance",
    "stair_env.attitude": "stair_env.onboard.proprioception",
    "stair_env.body_kernels": "stair_env.physics.body_kernels",
    "stair_env.camera": "stair_env.sensors.camera",
    "stair_env.camera.depth_kernels": "stair_env.sensors.camera.depth_model.depth_kernels",
    "stair_env.camera.follower": "stair_env.sensors.camera.third_person",
    "stair_env.camera.intrinsics": "stair_env.intrinsics",
    "stair_env.camera.renderers.looks": "stair_env.sensors.camera.renderers.shading_tables",
    "stair_env.cli": "stair_env_cli",
    "stair_env.cli.bench": "stair_env_cli.bench.command",
    "stair_env.cli.bench_perception": "stair_env_cli.bench.perception_rows",
    "stair_env.cli.bench_rows": "stair_env_cli.bench.env_rows",
    "stair_env.cli.common": "stair_env_cli.arguments",
    "stair_env.contact_sheet": "stair_env_cli.contact_sheet",
    "stair_env.distractors": "stair_env.scene.objects.distractors",
    "stair_env.episode": "stair_env.task.stair_ranges",
    "stair_env.gait": "stair_env.onboard.gait",
    "stair_env.imu": "stair_env.sensors.imu",
    "stair_env.info_batch": "stair_env.vectorized.infos",
    "stair_env.judgement": "stair_env.task.termination",
    "stair_env.kinematics": "stair_env.onboard.kinematics",
    "stair_env.looks": "stair_env.scene.random_appearance",
    "stair_env.motion": "stair_env.physics.simulation",
    "stair_env.odometry": "stair_env.onboard.proprioception",
    "stair_env.onlooker": "stair_env.sensors.camera.third_person_bullet",
    "stair_env.paper_stairs": "stair_env.scene.paper_stairs",
    "stair_env.pickling": "stair_env.common.pickling",
    "stair_env.placement": "stair_env.scene.random_distractors",
    "stair_env.privileged": "stair_env.task.privileged",
    "stair_env.progress": "stair_env.common.progress",
    "stair_env.provenance": "stair_env.common.files",
    "stair_env.results_page": "stair_env_cli.results_page",
    "stair_env.rewards": "stair_env.task.rewards",
    "stair_env.scene_spec": "stair_env.scene.spec",
    "stair_env.shared_arrays": "stair_env.vectorized.shared_arrays",
    "stair_env.simulation": "stair_env.physics.simulation",
    "stair_env.sources": "stair_env.task.sources",
    "stair_env.step_map": "stair_env.onboard.step_map",
    "stair_env.surroundings": "stair_env.scene.surroundings",
    "stair_env.textures": "stair_env.scene.materials.textures",
    "stair_env.timing": "stair_env_cli.bench.timing",
    "stair_env.viewpoints": "stair_env.scene.viewpoints",
    "stair_env.watch": "stair_env.vectorized.wait",
    "stair_env.worker_lifetime": "stair_env.vectorized.lifetime",
    "stair_env.worker_process": "stair_env.vectorized.worker",
    "stair_env.workers": "stair_env.vectorized.pool",
    # What `from stair_env.camera import intrinsics` asks for once the folder has its new name:
    "stair_env.sensors.camera.intrinsics": "stair_env.intrinsics",
}


def new_path(name: str) -> str | None:
    """Where a module of an old path lives now, or None for a path that never moved."""
    parts = name.split(".")
    for length in range(len(parts), 1, -1):
        target = MOVED.get(".".join(parts[:length]))
        if target is not None:
            return ".".join([target, *parts[length:]])
    return None


def install(package: str) -> None:
    """Let the old paths inside an imported top-level package work; calling it again changes nothing.

    Args:
        package: its name. Only the package that is imported now counts: a stranger of the same name is left alone.
    """
    finder = next((entry for entry in sys.meta_path if isinstance(entry, _MovedFinder)), None)
    if finder is None:
        finder = _MovedFinder()
        # Before the finder of files, which would load a second copy of what lies in a moved folder.
        sys.meta_path.insert(0, finder)
    finder.packages[package] = sys.modules[package]


def moved_names(package: str, names: Sequence[str], module: str) -> Callable[[str], object]:
    """A package's `__getattr__` for names that stood in a module which is a folder now.

    Args:
        package: the folder's dotted name, which was the module's.
        names: that stood there.
        module: dotted name of where they are now.
    """

    def get(name: str) -> object:
        if name not in names:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        _warn(f"{package}.{name}", f"{module}.{name}", stacklevel=2)
        return getattr(importlib.import_module(module), name)

    return get


def _warn(old: str, new: str, stacklevel: int) -> None:
    message = f"{old} has moved to {new}; the old path goes with the next release"
    warnings.warn(message, DeprecationWarning, stacklevel=stacklevel + 1)


class _MovedFinder(MetaPathFinder):
    """Finds modules by the paths they had."""

    def __init__(self) -> None:
        self.packages: dict[str, ModuleType] = {}

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        top = fullname.partition(".")[0]
        if top not in self.packages or sys.modules.get(top) is not self.packages[top]:
            return None
        new = new_path(fullname)
        real = importlib.util.find_spec(new) if new is not None else None
        if new is None or real is None:
            return None
        spec = ModuleSpec(fullname, _MovedLoader(new), origin=real.origin, is_package=False)
        spec.submodule_search_locations = real.submodule_search_locations
        return spec


class _MovedLoader(Loader):
    """Loads the module of the new path.

    Args:
        new: its dotted name.
    """

    def __init__(self, new: str) -> None:
        self.new = new

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        _warn(spec.name, self.new, stacklevel=2)
        module = importlib.import_module(self.new)
        self._own_spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self._own_spec  # which the import machinery has just replaced by the old path's

    def get_code(self, fullname: str) -> CodeType | None:
        """For `python -m OLD.PATH`."""
        _warn(fullname, self.new, stacklevel=2)
        spec = importlib.util.find_spec(self.new)
        assert spec is not None
        code: CodeType | None = spec.loader.get_code(self.new)  # type: ignore[union-attr]
        return code
