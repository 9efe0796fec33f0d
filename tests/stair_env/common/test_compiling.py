"""Compiled functions: a cache outside the package, rebuilt when damaged, done without where nothing can be written."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
import warnings
from pathlib import Path

import numpy as np
import pytest

from stair_env.common import compiling

MODULE = textwrap.dedent(
    """
    from numba import float64
    from stair_env.common.compiling import njit

    @njit(cache=True, nogil=True)
    def twice(x):
        return 2 * x

    @njit(float64(float64), cache=True)
    def thrice(x):
        return 3 * x

    if __name__ == "__main__":
        print(twice(2.0), thrice(2.0), sum(twice.stats.cache_hits.values()) + sum(thrice.stats.cache_hits.values()))
    """
)


def run(tmp_path: Path, **environment: str) -> subprocess.CompletedProcess:
    (tmp_path / "doubled.py").write_text(MODULE)
    root = str(Path(compiling.__file__).parents[2])
    kept = {
        name: value for name, value in os.environ.items() if name not in (compiling.CACHE_VARIABLE, "NUMBA_CACHE_DIR")
    }
    return subprocess.run(
        [sys.executable, "doubled.py"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**kept, "PYTHONPATH": root, **environment},
        check=False,
    )


def test_the_cache_is_the_users_and_serves_the_next_process(tmp_path: Path) -> None:
    home = tmp_path / "cache"
    first, second = (run(tmp_path, XDG_CACHE_HOME=str(home)) for _ in range(2))
    assert (first.stdout, second.stdout) == ("4.0 6.0 0\n", "4.0 6.0 2\n"), first.stderr + second.stderr
    assert list((home / "stair_env" / "kernels").rglob("*.nbi")) and not (tmp_path / "__pycache__").exists()


@pytest.mark.parametrize(("suffix", "damage"), [("nbi", b"no cache at all"), ("nbc", None)])
def test_a_damaged_cache_is_rebuilt(suffix: str, damage: bytes | None, tmp_path: Path) -> None:
    home = tmp_path / "cache"
    run(tmp_path, XDG_CACHE_HOME=str(home))
    for file in home.rglob(f"*.{suffix}"):
        content = file.read_bytes()
        file.write_bytes(content[: len(content) // 2] if damage is None else damage)
    damaged, again = (run(tmp_path, XDG_CACHE_HOME=str(home)) for _ in range(2))
    assert damaged.returncode == 0 and damaged.stdout.startswith("4.0 6.0"), damaged.stderr
    assert again.stdout == "4.0 6.0 2\n"


def test_where_no_cache_can_be_written_there_is_a_spare_one_and_one_warning(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")  # no folder can be made below a file, whoever asks
    spare = tmp_path / "tmp"
    spare.mkdir()
    done = run(tmp_path, XDG_CACHE_HOME=str(tmp_path / "file"), TMPDIR=str(spare))
    assert done.stdout == "4.0 6.0 0\n" and done.stderr.count("CacheWarning") == 1
    assert compiling.CACHE_VARIABLE in done.stderr and list(spare.rglob("*.nbi"))


def test_where_nothing_at_all_can_be_written_kernels_are_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiling.cache_folder.cache_clear()
    monkeypatch.delenv(compiling.CACHE_VARIABLE, raising=False)
    monkeypatch.setattr(compiling, "_is_usable", lambda *args, **kwargs: False)
    with pytest.warns(compiling.CacheWarning, match="compiled anew"):
        assert compiling.cache_folder() is None
    doubled = compiling.njit(cache=True)(lambda x: x + x)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.array_equal(doubled(np.arange(3)), [0, 2, 4])
    compiling.cache_folder.cache_clear()


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="about owners")
def test_a_spare_cache_that_others_can_write_is_not_used(tmp_path: Path) -> None:
    folder = tmp_path / "spare"
    folder.mkdir()
    folder.chmod(0o777)  # whoever writes a cache has it run
    assert not compiling._is_usable(folder, private=True)
    link = tmp_path / "link"
    link.symlink_to(tmp_path)
    assert not compiling._is_usable(link, private=True)
    assert compiling._is_usable(tmp_path / "own", private=True)
