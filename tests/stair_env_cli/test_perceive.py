"""`stair-env perceive` and `record`, as a user calls them: files, folders, colour alone, recordings that break off."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from perception.data.stair_dataset import StairDataset
from perception.looking.frame_measurement import NO_DEPTH
from stair_env.common.transforms import look_along
from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.renderers.factory import make_renderer
from stair_env.stairs import StairSpec
from stair_env_cli.main import main

CAMERA = D435I_COLOR_MODES["640x480"]
RISER_M, TREAD_M = 0.15, 0.30


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with rgb/ and depth/ of a rendered staircase, gravity in side-cars."""
    root = tmp_path_factory.mktemp("stairs")
    scene = Scene(SceneSpec(StairSpec(riser_height=RISER_M, tread_depth=TREAD_M)))
    renderer = make_renderer("raycast", scene)
    (root / "rgb").mkdir()
    (root / "depth").mkdir()
    for index in range(2):
        pose = look_along(np.array([-0.9 + 0.02 * index, 0.0, 0.9]), 0.1, 0.5, 0.03)
        image = renderer.render(CAMERA, pose)
        cv2.imwrite(str(root / "rgb" / f"{index}.png"), image.rgb[..., ::-1])
        cv2.imwrite(str(root / "depth" / f"{index}.png"), np.rint(1000 * image.depth_m).astype(np.uint16))
        (root / "rgb" / f"{index}.json").write_text(json.dumps({"gravity": (9.8 * pose[2, :3]).tolist()}))
    renderer.close()
    return root


def perceive(tmp_path: Path, *words: str) -> dict[str, Any]:
    out = tmp_path / "out.json"
    assert main(["perceive", *words, "--no-pictures", "--json", str(out)]) == 0
    found: dict[str, Any] = json.loads(out.read_text())
    return found


def test_a_folder_is_measured_with_a_line_a_frame(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = perceive(tmp_path, str(pictures))["frames"]
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(frames) == 2 and all(" ms, " in line and " a second" in line for line in lines)
    for frame in frames:
        assert frame["gravity_source"] == "given" and frame["hints"] == [] and frame["direction"] == "ascending"
        for step in frame["steps"]:
            assert abs(step["width_m"] - TREAD_M) < 0.015 and abs(step["height_m"] - RISER_M) < 0.008


def test_two_files_and_two_folders_as_before(pictures: Path, tmp_path: Path) -> None:
    one = perceive(tmp_path, str(pictures / "rgb" / "0.png"), str(pictures / "depth" / "0.png"))["frames"]
    two = perceive(tmp_path, str(pictures / "rgb"), str(pictures / "depth"))["frames"]
    assert one[0]["steps"] == two[0]["steps"] and len(two) == 2


def test_colour_alone_gives_lines_without_millimetres(pictures: Path, tmp_path: Path) -> None:
    frame = perceive(tmp_path, str(pictures / "rgb" / "0.png"))["frames"][0]
    assert not frame["valid"] and frame["steps"] == [] and frame["reason"] == NO_DEPTH


def test_a_record_measures_the_same(pictures: Path, tmp_path: Path) -> None:
    first = perceive(tmp_path, str(pictures), "--record", str(tmp_path / "walk"))["frames"]
    again = perceive(tmp_path, str(tmp_path / "walk"))["frames"]
    for a, b in zip(first, again):
        assert b["gravity_source"] == "imu"
        for step, other in zip(a["steps"], b["steps"], strict=True):
            assert abs(step["width_m"] - other["width_m"]) < 1e-3 and abs(step["height_m"] - other["height_m"]) < 1e-3
        for name in ("pitch_rad", "roll_rad", "yaw_rad"):
            assert abs(np.degrees(a[name] - b[name])) < 0.1


def test_nobody_says_where_down_is(pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [str(pictures / "rgb" / "0.png"), str(pictures / "depth" / "0.png")]
    side_car = pictures / "rgb" / "0.json"
    text = side_car.read_text()
    side_car.unlink()
    try:
        frame = perceive(tmp_path, *words)["frames"][0]
    finally:
        side_car.write_text(text)
    assert frame["gravity_source"] in ("level", "depth", "refined")
    assert "[gravity: " in capsys.readouterr().out


def test_what_breaks_off_is_kept_and_said(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "walk"
    perceive(tmp_path, str(pictures), "--record", str(folder))
    from perception.sources import folders
    from perception.sources.source import BrokenRecordingError

    real = folders.read_pair

    def breaking(colour: Path, *args: Any) -> Any:
        if colour.stem == "000001":
            raise BrokenRecordingError("walk: cut short after 1 frames")
        return real(colour, *args)

    monkeypatch.setattr(folders, "read_pair", breaking)
    out = tmp_path / "out.json"
    words = ["perceive", str(folder), "--no-pictures", "--json", str(out), "--record", str(tmp_path / "kept")]
    assert main(words) == 2
    written = json.loads(out.read_text())
    assert len(written["frames"]) == 1 and "cut short" in written["error"]
    assert len((tmp_path / "kept" / "rgb.txt").read_text().splitlines()) == 1
    assert capsys.readouterr().err.strip() == "stair-env perceive: error: walk: cut short after 1 frames"


@pytest.mark.parametrize(
    "words, says",
    [
        ([], "name one source"),
        (["a", "--device"], "name one source"),
        (["nowhere"], "nowhere: no such file"),
        (["a", "b", "c"], "one word or two"),
        (["a", "--size", "big"], "WIDTHxHEIGHT"),
        (["a", "--depth-scale", "3"], "depth-scale"),
    ],
)
def test_wrong_words_are_one_line(words: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["perceive", *words]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1


def test_record_writes_a_set_that_training_reads(pictures: Path, tmp_path: Path) -> None:
    out = tmp_path / "set"
    for count in (2, 4):  # a second call goes on
        assert main(["record", str(pictures), "--output", str(out)]) == 0
        assert len(StairDataset(out)) == count
    sample = StairDataset(out)[0]
    assert sample.rgb.shape == (512, 512, 3) and len(sample.lines) >= 2
    assert "unchecked" in sample.meta["labels"] and len(sample.meta["gravity"]) == 3
    assert main(["record", str(out), "--output", str(tmp_path / "bare"), "--labels", "none"]) == 0
    assert sorted(path.name for path in (tmp_path / "bare").iterdir()) == ["depthes", "images"]


@pytest.mark.parametrize("kind", ["colourised", "same file", "swapped"])
def test_a_depth_file_that_is_no_depth_ends_in_an_error_beside_the_lines(
    kind: str, pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rgb, depth = pictures / "rgb" / "0.png", pictures / "depth" / "0.png"
    if kind == "colourised":
        grey = cv2.convertScaleAbs(cv2.imread(str(depth), cv2.IMREAD_UNCHANGED), alpha=0.06)
        cv2.imwrite(str(tmp_path / "depth.png"), cv2.applyColorMap(grey, cv2.COLORMAP_TURBO))
        depth = tmp_path / "depth.png"
    words = [str(rgb), str(rgb if kind == "same file" else depth)]
    out = tmp_path / "out.json"
    assert main(["perceive", *(words[::-1] if kind == "swapped" else words), "--no-pictures", "--json", str(out)]) == 2
    result, error = json.loads(out.read_text()), capsys.readouterr().err
    assert len(result["frames"]) == 1 and result["frames"][0]["steps"] == [] and result["frames"][0]["hints"]
    assert result["error"] in error and error.startswith("stair-env perceive: error: ") and error.count("\n") == 1


def test_a_name_that_is_not_utf_8(pictures: Path, tmp_path: Path) -> None:
    words = [tmp_path / os.fsdecode(b"tr\xe9ppe" + end) for end in (b".png", b"_depth.png")]
    for name, path in zip(("rgb", "depth"), words):
        path.write_bytes((pictures / name / "0.png").read_bytes())
    folder = tmp_path / os.fsdecode(b"t\xe9")
    assert len(perceive(tmp_path, *map(str, words), "--record", str(folder))["frames"]) == 1
    assert len(perceive(tmp_path, str(folder))["frames"][0]["steps"]) > 0
