"""Table 7 in small, and the files that `perceive` reads."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from perception.data.frame_files import FrameFileError, FrameOptions, d435i_intrinsics, pair_files, read_frame
from perception.geometry.results import StairEstimate, StepMeasurement
from perception.reproduction import table7_geometry
from perception.reproduction.ideal_detector import IdealDetector
from perception.reproduction.table7_geometry import MeasureConfig, draw_pose, run_measurement, steps_of
from stair_env.common.validation import SpecError
from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.scene.paper_stairs import PAPER_STAIRS
from stair_env.sensors.camera.depth_error import DepthErrorConfig
from stair_env_cli.main import main

CAMERA = D435I_COLOR_MODES["640x480"]


def sharp_depth(**changes: Any) -> DepthErrorConfig:
    """A camera whose matching neither rounds creases nor loses treads, so that few frames tell of formulas."""
    off = dict.fromkeys(("structured_px", "lost_treads", "false_patches", "single_holes", "misalignment_px"), 0.0)
    return DepthErrorConfig(crease_window_px=(1.0, 1.0), focal_error_range=0.0, fattened_share=0.0, **off, **changes)


@pytest.fixture(scope="module")
def result() -> Iterator[dict[str, Any]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(table7_geometry, "DepthErrorConfig", sharp_depth)
        yield run_measurement(MeasureConfig(network="ideal", poses=1), seed=0)


def test_rows_are_those_of_the_paper(result: dict[str, Any]) -> None:
    rows = result["rows"]
    assert [(row["stair"], row["step"], row["direction"]) for row in rows] == [
        (stair.name, step, direction)
        for stair in PAPER_STAIRS
        for direction in ("ascending", "descending")
        for step in (1, 2, 3)
    ]
    assert rows[0]["true_mm"] == [296, 160]
    for row in rows:
        assert row["measured_mm"] is None or np.abs(np.subtract(row["measured_mm"], row["true_mm"])).max() < 25.0


def test_the_geometry_is_exact_to_millimetres(result: dict[str, Any]) -> None:
    """Far above the noise of so few frames, far below what a wrong formula would give."""
    for direction, (width, height) in (("ascending", (6.0, 6.0)), ("descending", (12.0, 8.0))):
        measured = result["rmse_mm"][direction]
        assert 0.0 < measured[0] < width
        assert 0.0 < measured[1] < height
        assert result["rmse_mm_by"]["planes"][direction]["coverage"] > 0.7


@pytest.mark.parametrize("depth", ["model", "stereo"])
def test_on_depth_as_cameras_match_it_most_steps_are_right_to_centimetres(depth: str) -> None:
    """Of so few frames one may be far off, which a mean would show and a median does not."""
    shown = run_measurement(MeasureConfig(network="ideal", poses=2, stairs=PAPER_STAIRS[:1], depth=depth), seed=0)
    pairs = [(row["measured_mm"], row["true_mm"]) for row in shown["rows"] if row["measured_mm"] is not None]
    assert len(pairs) >= 3
    width, height = np.median(np.abs(np.subtract(*zip(*pairs))), axis=0)
    assert width < 25.0 and height < 15.0


def test_the_papers_fit_and_the_uncalibrated_unit_are_beside_it(result: dict[str, Any]) -> None:
    ours = result["rmse_mm_by"]["planes"]["ascending"]["rmse_mm"]
    assert result["rmse_mm_by"]["paper"]["ascending"]["rmse_mm"][0] > ours[0]
    assert "ascending" in result["rmse_mm_by"]["planes, scale bias 2 %"]
    assert {"ascending, day", "ascending, night"} <= set(result["rmse_mm_by"]["planes"])
    json.dumps(result)


def test_same_seed_same_table() -> None:
    config = MeasureConfig(network="ideal", poses=2, stairs=PAPER_STAIRS[:1])
    assert run_measurement(config, seed=0) == run_measurement(config, seed=0)


@pytest.mark.parametrize("direction", ["up", "down"])
def test_poses_are_as_documented(direction: Any) -> None:
    rng = np.random.default_rng(0)
    spec = PAPER_STAIRS[3].spec(direction)
    for _ in range(30):
        pose = draw_pose(spec, rng, CAMERA)
        assert 0.6 <= -pose[0, 3] <= 1.8
        forward, right = pose[:3, 2], pose[:3, 0]
        assert abs(math.atan2(forward[1], forward[0])) <= math.radians(20.0) + 1e-9
        assert abs(math.asin(right[2])) <= math.radians(5.0) + 1e-9


def test_a_step_far_from_every_true_one_does_not_count() -> None:
    profile = PAPER_STAIRS[0].spec("up").profile()
    step = StepMeasurement(0.3, 0.15, 0.0, 0.0, distance_m=1.0)
    assert [index for index, *_ in steps_of(StairEstimate(True, 1, steps=(step,)), profile, camera_x=-1.0)] == [0]
    assert not list(steps_of(StairEstimate(True, 1, steps=(step,)), profile, camera_x=-1.4))


def test_config_names_what_is_wrong() -> None:
    with pytest.raises(SpecError, match="network"):
        MeasureConfig(network="yolo")  # type: ignore[arg-type]
    with pytest.raises(SpecError, match="depth"):
        MeasureConfig(depth="lidar")
    with pytest.raises(SpecError, match="poses"):
        MeasureConfig(poses=0)


def test_matched_depth_is_measured_too() -> None:
    config = MeasureConfig(network="ideal", poses=1, stairs=PAPER_STAIRS[:1], depth="stereo")
    result = run_measurement(config, seed=1)
    assert result["depth"] == "stereo"
    assert result["rmse_mm_by"]["planes"]["ascending"]["coverage"] > 0.5
    assert 0.0 < result["rmse_mm"]["ascending"][1] < 10.0


def test_ideal_detector_needs_its_answers_first() -> None:
    detector = IdealDetector()
    with pytest.raises(ValueError, match="announced 0"):
        detector.detect([np.zeros((4, 4, 3), np.uint8)], [np.zeros((4, 4), np.float32)])
    with pytest.raises(ValueError, match="rng"):
        IdealDetector(jitter_px=1.0)


def test_measure_command_writes_the_contracts_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "table7.json"
    code = main(["measure", "--network", "ideal", "--poses", "1", "--stairs", "Stair6", "--json", str(target)])
    assert code == 0
    written = json.loads(target.read_text())
    assert {"rows", "rmse_mm"} <= set(written)
    assert set(written["rmse_mm"]) == {"ascending", "descending"}
    assert "Stair6" in capsys.readouterr().out


# ---------------------------------------------------------------- files


def write_pair(folder: Path, name: str = "a", size: tuple[int, int] = (48, 64)) -> tuple[Path, Path]:
    for part in ("rgb", "depth"):
        (folder / part).mkdir(exist_ok=True)
    rgb, depth = folder / "rgb" / f"{name}.png", folder / "depth" / f"{name}.png"
    cv2.imwrite(str(rgb), np.full((*size, 3), 90, np.uint8))
    cv2.imwrite(str(depth), np.full(size, 1500, np.uint16))
    return rgb, depth


def test_frames_read_with_units_and_defaults(tmp_path: Path) -> None:
    frame = read_frame(*write_pair(tmp_path), FrameOptions())
    assert frame.depth_m == pytest.approx(1.5)
    assert frame.gravity == pytest.approx([0.0, -9.8, 0.0])
    assert frame.intrinsics == CAMERA.scaled(64, 48)
    other = read_frame(*write_pair(tmp_path), FrameOptions(depth_scale_m=0.0001))
    assert other.depth_m == pytest.approx(0.15)


def test_side_car_overrides_options(tmp_path: Path) -> None:
    rgb, depth = write_pair(tmp_path)
    side_car = {"fx": 50.0, "fy": 51.0, "cx": 30.0, "cy": 20.0, "gravity": [0.0, -9.0, -3.0]}
    rgb.with_suffix(".json").write_text(json.dumps(side_car))
    frame = read_frame(rgb, depth, FrameOptions(intrinsics={"fx": 1.0}, gravity=(1.0, 0.0, 0.0)))
    assert (frame.intrinsics.fx, frame.intrinsics.cy) == (50.0, 20.0)
    assert frame.gravity == pytest.approx([0.0, -9.0, -3.0])


@pytest.mark.parametrize(
    ("side_car", "message"),
    [
        ({"fx": 50.0}, "lack fy, cx, cy"),
        ({"fx": 50.0, "fy": 50.0, "cx": 500.0, "cy": 20.0}, "cx"),
        ({"fx": -1.0, "fy": 50.0, "cx": 30.0, "cy": 20.0}, "fx"),
        ({"gravity": [0.0, 0.0, 0.0]}, "gravity"),
        ({"gravity": "down"}, "gravity"),
        ({"depth_scale": -1.0}, "depth_scale"),
    ],
)
def test_a_wrong_side_car_is_named(tmp_path: Path, side_car: dict[str, Any], message: str) -> None:
    rgb, depth = write_pair(tmp_path)
    rgb.with_suffix(".json").write_text(json.dumps(side_car))
    with pytest.raises(FrameFileError, match=message):
        read_frame(rgb, depth, FrameOptions())


def test_pairs_of_folders_and_what_is_missing(tmp_path: Path) -> None:
    for name in ("b", "a"):
        write_pair(tmp_path, name)
    pairs = pair_files(tmp_path / "rgb", tmp_path / "depth")
    assert [rgb.stem for rgb, _ in pairs] == ["a", "b"]
    (tmp_path / "depth" / "b.png").unlink()
    with pytest.raises(FrameFileError, match="named b"):
        pair_files(tmp_path / "rgb", tmp_path / "depth")
    with pytest.raises(FrameFileError, match="no such file"):
        pair_files(tmp_path / "nowhere", tmp_path / "depth")
    with pytest.raises(FrameFileError, match="both"):
        pair_files(tmp_path / "rgb", tmp_path / "depth" / "a.png")


def test_sizes_must_agree(tmp_path: Path) -> None:
    rgb, _ = write_pair(tmp_path)
    _, other = write_pair(tmp_path, "b", size=(50, 64))
    with pytest.raises(FrameFileError, match="aligned"):
        read_frame(rgb, other, FrameOptions())


@pytest.mark.parametrize("size", [(640, 480), (1280, 720), (424, 240), (512, 512), (300, 200)])
def test_assumed_intrinsics_fit_any_size(size: tuple[int, int]) -> None:
    model = d435i_intrinsics(*size)
    assert (model.width, model.height) == size
    assert 0.6 < model.fx / size[0] < 1.2


def test_perceive_command_on_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b"):
        write_pair(tmp_path, name, size=(120, 160))
    target, pictures = tmp_path / "out.json", tmp_path / "pictures"
    arguments = ["perceive", str(tmp_path / "rgb"), str(tmp_path / "depth"), "--json", str(target)]
    assert main([*arguments, "--output", str(pictures)]) == 0
    frames = json.loads(target.read_text())["frames"]
    assert [Path(frame["rgb"]).stem for frame in frames] == ["a", "b"]
    assert all(frame["valid"] is False and frame["steps"] == [] for frame in frames)
    assert sorted(path.name for path in pictures.iterdir()) == ["a_stairs.png", "b_stairs.png"]
    assert capsys.readouterr().out.count("no stairs measured") == 2


@pytest.mark.parametrize("extra", [["--gravity", "0", "0", "0"], ["--intrinsics", "missing.json"]])
def test_perceive_command_names_bad_input(tmp_path: Path, extra: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    rgb, depth = write_pair(tmp_path)
    assert main(["perceive", str(rgb), str(depth), *extra]) != 0
    assert "error" in capsys.readouterr().err
