"""Another package named like one of ours, in the way: say which file hides what, instead of a missing module.

`perception` and `policies` are common names for folders of one's own, and whatever comes first on `sys.path` wins.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[3]  # where the packages lie side by side
SIBLINGS = ("perception", "policies", "stair_env_cli")


class ShadowedPackageError(ImportError):
    """A module of another project is found in place of a package of ours."""


def import_sibling(name: str) -> ModuleType:
    """Import a module of a package beside `stair_env`.

    Raises:
        ShadowedPackageError: another package has its name.
    """
    package = name.partition(".")[0]
    try:
        module = importlib.import_module(name)
    except ImportError:
        check_sibling(package)
        raise
    if not Path(str(module.__file__)).resolve().is_relative_to(ROOT / package):
        check_sibling(package)
    return module


def check_sibling(package: str) -> None:
    """Make sure that `import package` finds ours.

    Raises:
        ShadowedPackageError: it finds another.
    """
    hider = _hider(package)
    if hider is not None:
        raise ShadowedPackageError(
            f"{hider} hides stair-env's own package {package!r} ({ROOT / package}): rename it, or start Python where "
            f"it is not found first",
            name=package,
            path=str(hider),
        )


def _hider(package: str) -> str | None:
    """File of the other package, or None where ours is found."""
    ours = ROOT / package
    if not ours.is_dir():
        return None
    loaded = sys.modules.get(package)
    spec: Any = getattr(loaded, "__spec__", None) if loaded is not None else importlib.util.find_spec(package)
    origin = getattr(loaded, "__file__", None) or getattr(spec, "origin", None)
    if origin is None or Path(origin).resolve().parent == ours:
        return None
    return str(origin)


class _HiddenFinder(MetaPathFinder):
    """Asked last, when a module was found nowhere: whether it is one of ours that another package hides."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        package, *rest = fullname.split(".")
        if package not in SIBLINGS or not rest:
            return None
        file = ROOT.joinpath(package, *rest)
        if file.with_suffix(".py").is_file() or (file / "__init__.py").is_file():
            check_sibling(package)
        return None


def install() -> None:
    """Let imports that fail because of a hidden package say so; calling it again changes nothing."""
    if not any(type(finder).__name__ == _HiddenFinder.__name__ for finder in sys.meta_path):
        sys.meta_path.append(_HiddenFinder())
