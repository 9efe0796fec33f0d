"""Results files: whole or as before, wherever a path leads."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from stair_env.common.files import atomic_path, is_standard_output, takes_files_beside, write_json

ROOT = os.getuid() == 0 if hasattr(os, "getuid") else False


def written(path: Path) -> object:
    return json.loads(path.read_text())["rows"]


@pytest.mark.parametrize("chain", [1, 3])
def test_a_link_stays_and_its_target_is_written(chain: int, tmp_path: Path) -> None:
    real, last = tmp_path / "elsewhere" / "real.json", tmp_path / "elsewhere" / "real.json"
    real.parent.mkdir()
    real.write_text("old")
    for number in range(chain):
        link = tmp_path / f"link{number}.json"
        link.symlink_to(last)
        last = link
    write_json(last, {"rows": [1]})
    assert last.is_symlink() and not real.is_symlink() and written(real) == [1]


def test_a_link_to_nothing_yet_makes_its_target(tmp_path: Path) -> None:
    link = tmp_path / "link.json"
    link.symlink_to(tmp_path / "later" / "real.json")
    write_json(link, {"rows": []})
    assert link.is_symlink() and written(tmp_path / "later" / "real.json") == []


def test_links_in_a_circle_are_an_error(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    with pytest.raises(OSError):
        write_json(tmp_path / "a", {})
    assert (tmp_path / "a").is_symlink()


@pytest.mark.skipif(not ROOT, reason="makes a device")
def test_a_device_is_written_to_and_stays_one(tmp_path: Path) -> None:
    null = tmp_path / "null"
    os.mknod(null, 0o666 | stat.S_IFCHR, os.makedev(1, 3))
    write_json(null, {"rows": []})
    assert stat.S_ISCHR(os.lstat(null).st_mode) and not takes_files_beside(null)
    assert [path.name for path in tmp_path.iterdir()] == ["null"]


def test_a_pipe_hands_its_reader_everything(tmp_path: Path) -> None:
    pipe, read = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    write_json(pipe, {"rows": list(range(20_000))})  # more than a pipe holds
    reader.join(10)
    assert json.loads(read[0])["rows"][-1] == 19_999 and stat.S_ISFIFO(os.lstat(pipe).st_mode)


@pytest.mark.parametrize("to", ["pipe", "file"])
def test_standard_output_keeps_what_was_printed(to: str, tmp_path: Path) -> None:
    code = (
        "from stair_env.common.files import *; print('before'); "
        "write_json('/dev/stdout', {'rows': [1]}); print('after', is_standard_output('/dev/stdout'))"
    )
    target = tmp_path / "out.txt"
    with target.open("w") as file:
        done = subprocess.run(
            [sys.executable, "-c", code], stdout=file if to == "file" else subprocess.PIPE, text=True, check=True
        )
    text = target.read_text() if to == "file" else done.stdout
    assert text.startswith("before\n{") and text.endswith("}\nafter True\n")


def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    path.write_text("old")
    with pytest.raises(RuntimeError), atomic_path(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_permissions_stay_and_new_files_get_the_usual_ones(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    old.write_text("")
    old.chmod(0o640)
    for path in (old, new):
        write_json(path, {})
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(old.stat().st_mode) == 0o640 and stat.S_IMODE(new.stat().st_mode) == 0o666 & ~umask


@pytest.mark.parametrize("name", ["x" * 250 + ".json", "a." + "b" * 250, os.fsdecode(b"tr\xe9ppe.json"), "é 雪.json"])
def test_any_name_that_a_folder_takes_can_be_written(name: str, tmp_path: Path) -> None:
    write_json(tmp_path / name, {"rows": [2]})
    assert written(tmp_path / name) == [2] and len(list(tmp_path.iterdir())) == 1


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError):
        write_json(tmp_path, {})


@pytest.mark.skipif(not ROOT or sys.platform != "linux", reason="drops root's rights")
def test_a_file_in_a_folder_that_takes_no_new_ones_is_written_in_place(tmp_path: Path) -> None:
    folder = tmp_path / "locked"
    folder.mkdir()
    (folder / "given.json").write_text("old")
    (folder / "given.json").chmod(0o666)
    folder.chmod(0o555)
    for parent in (tmp_path, *tmp_path.parents):
        parent.chmod(0o755)
        if parent.name.startswith("pytest-of-"):
            break
    code = f"""
import os, sys
sys.path.insert(0, {str(Path(__file__).parents[3])!r})
from stair_env.common.files import write_json
os.setgid(65534); os.setuid(65534)
write_json({str(folder / "given.json")!r}, {{"rows": [3]}})
try:
    write_json({str(folder / "new.json")!r}, {{}})
except PermissionError:
    print("refused")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd="/", check=False)
    assert done.stdout == "refused\n", done.stderr
    assert written(folder / "given.json") == [3]


def test_an_ordinary_file_is_no_standard_output(tmp_path: Path) -> None:
    assert takes_files_beside(tmp_path / "new") and not is_standard_output(tmp_path / "new")
