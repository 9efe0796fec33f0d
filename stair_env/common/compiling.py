"""Compiled functions whose cache lies outside the package, and is never the reason that nothing runs.

Use `njit` of this module as numba's own. The cache is kept in, whichever can be written first, the folder that
STAIR_ENV_KERNEL_CACHE (or numba's NUMBA_CACHE_DIR) names, the user's cache folder, a private folder for temporary
files; failing all of them, functions are compiled anew in every process.
"""

from __future__ import annotations

import contextlib
import functools
import os
import stat
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
from numba.core import sigutils
from numba.core.caching import FunctionCache

CACHE_VARIABLE = "STAIR_ENV_KERNEL_CACHE"


class CacheWarning(RuntimeWarning):
    """Kernels are compiled more often than they need be; the message says why and what helps."""


def njit(signature: Any = None, *, cache: bool = False, **options: Any) -> Any:
    """As `numba.njit`, with this module's cache.

    Args:
        signature: of one specialisation, or the function itself.
        cache: whether machine code is kept for the next process.
        options: of `numba.njit`.
    """
    if callable(signature) and not sigutils.is_signature(signature):  # used without parentheses
        return njit(cache=cache, **options)(signature)
    signatures = signature if isinstance(signature, list) else [] if signature is None else [signature]

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(**options)(function)
        if dispatcher is function:  # NUMBA_DISABLE_JIT
            return function
        if cache:
            _attach_cache(dispatcher, function)
        for wanted in signatures:
            dispatcher.compile(wanted)
        if signatures:
            dispatcher.disable_compile()
        return dispatcher

    return compiled


def _attach_cache(dispatcher: Any, function: Callable[..., Any]) -> None:
    folder = cache_folder()
    if folder is None:
        return
    try:
        with _cache_in(folder):
            dispatcher._cache = KernelCache(function)
    except (RuntimeError, OSError) as error:
        _warn_once(f"kernels are compiled anew in every process: {folder} holds no cache ({error})")


class KernelCache(FunctionCache):
    """A function's cache that is emptied and rebuilt where it cannot be read, and does without where not written."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Machine code of a signature, or None."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # cut short or written over: unpickling and linking raise anything
            _warn_once(f"the kernel cache in {self.cache_path} is damaged and is rebuilt ({type(error).__name__})")
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep machine code, if it can be."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _warn_once(f"the kernel cache in {self.cache_path} cannot be written: {error}")
        except Exception:  # the index on disk is damaged: begin a new one
            with contextlib.suppress(Exception):
                self.flush()
                super().save_overload(sig, data)


@functools.cache
def cache_folder() -> str | None:
    """Where kernels are cached; None where nothing can be written."""
    named = os.environ.get(CACHE_VARIABLE) or os.environ.get("NUMBA_CACHE_DIR")
    if named is not None and _is_usable(Path(named)):
        return named
    wanted = Path(named) if named else _user_folder()
    if not named and _is_usable(wanted):
        return str(wanted)
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    spare = Path(tempfile.gettempdir()) / f"stair_env-kernels-{user}"
    remedy = f"set {CACHE_VARIABLE} to a folder that can be written"
    if _is_usable(spare, private=True):
        os.environ[CACHE_VARIABLE] = str(spare)  # so that child processes say nothing more about it
        _warn_once(f"{wanted} cannot be written: the kernel cache is in {spare}; {remedy}")
        return str(spare)
    _warn_once(f"neither {wanted} nor {spare} can be written: kernels are compiled anew in every process; {remedy}")
    return None


def _user_folder() -> Path:
    """The user's folder for caches on this system."""
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or os.path.expanduser("~/AppData/Local")
    elif sys.platform == "darwin":
        base = os.path.expanduser("~/Library/Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(base) / "stair_env" / "kernels"


def _is_usable(folder: Path, private: bool = False) -> bool:
    """Whether a folder can be written; a private one must be ours alone, for a cache is code."""
    try:
        if str(folder).startswith("~"):  # a user without a home
            return False
        folder.mkdir(mode=0o700 if private else 0o777, parents=True, exist_ok=True)
        if private and hasattr(os, "getuid"):
            found = folder.lstat()
            if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o022:
                return False
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


@contextlib.contextmanager
def _cache_in(folder: str) -> Iterator[None]:
    """Have numba choose this folder, for our functions and nobody else's."""
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = folder
    try:
        yield
    finally:
        config.CACHE_DIR = before


@functools.cache
def _warn_once(message: str) -> None:
    warnings.warn(message, CacheWarning, stacklevel=2)
