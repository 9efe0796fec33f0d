"""Each mistake that people make has a hint, and a good frame has none."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from perception.sources.folders import FileOptions, FilePairs
from perception.sources.hints import frame_hints
from perception.sources.preparation import Preparation, SourceFrame, prepared
from stair_env.intrinsics import D435I_COLOR_MODES, Intrinsics
from tests.perception.sources.conftest import drawn

CAMERA = D435I_COLOR_MODES["640x480"]
LEVEL = np.array([0.0, -9.8, 0.0])
DEPTH = np.linspace(0.5, 3.0, 480 * 640, dtype=np.float32).reshape(480, 640)


def starts(hints: tuple[str, ...]) -> list[str]:
    return [hint.split(":")[0] for hint in hints]


def test_a_good_frame_has_none() -> None:
    assert frame_hints(DEPTH, CAMERA, LEVEL) == ()
    assert frame_hints(None, CAMERA, None) == ()


@pytest.mark.parametrize("factor", [1000.0, 0.001, 20.0])
def test_a_wrong_unit(factor: float) -> None:
    assert starts(frame_hints(DEPTH * np.float32(factor), CAMERA, LEVEL)) == ["depth-unit"]


def test_no_depth_at_all() -> None:
    assert starts(frame_hints(np.zeros_like(DEPTH), CAMERA, LEVEL)) == ["depth-empty"]


def test_flipped_gravity_and_its_unit() -> None:
    assert starts(frame_hints(DEPTH, CAMERA, -LEVEL)) == ["gravity-flipped"]
    assert starts(frame_hints(DEPTH, CAMERA, LEVEL / 9.8)) == ["gravity-unit"]
    tilted = 9.8 * np.array([0.0, -np.cos(1.0), -np.sin(1.0)])  # looking down by 57 degrees
    assert frame_hints(DEPTH, CAMERA, tilted) == ()


@pytest.mark.parametrize(
    "model",
    [
        Intrinsics(640, 480, 1400.0, 1400.0, 320.0, 240.0),  # of three times the resolution
        Intrinsics(640, 480, 150.0, 150.0, 320.0, 240.0),
        Intrinsics(640, 480, 615.0, 922.0, 320.0, 240.0),
        Intrinsics(640, 480, 615.0, 615.0, 600.0, 240.0),  # the principal point of 1280 columns, nearly
    ],
)
def test_a_focal_length_that_does_not_fit(model: Intrinsics) -> None:
    assert starts(frame_hints(DEPTH, model, LEVEL)) == ["focal-length"]


def write(folder: Path, name: str, image: np.ndarray) -> Path:
    path = folder / name
    assert cv2.imwrite(str(path), image)
    return path


def read(colour: Path, depth: Path, options: FileOptions | None = None) -> SourceFrame:
    return next(prepared(FilePairs([(colour, depth)], options or FileOptions()), Preparation()))


def pictures(folder: Path) -> tuple[Path, Path]:
    frame = drawn(1)[0]
    assert frame.depth_m is not None
    depth = np.rint(1000 * frame.depth_m).astype(np.uint16)
    return write(folder, "a.png", frame.rgb[..., ::-1]), write(folder, "a_depth.png", depth)


def test_a_good_pair_has_none(tmp_path: Path) -> None:
    assert read(*pictures(tmp_path)).hints == ()


def test_colourised_depth_is_left_out(tmp_path: Path) -> None:
    colour, depth = pictures(tmp_path)
    grey = np.clip(cv2.imread(str(depth), cv2.IMREAD_UNCHANGED) / 16, 0, 255).astype(np.uint8)
    frame = read(colour, write(tmp_path, "jet.png", cv2.applyColorMap(grey, cv2.COLORMAP_JET)))
    assert starts(frame.hints) == ["depth-colourised"] and frame.depth_m is None


def test_eight_bit_depth_has_a_hint_until_its_level_is_given(tmp_path: Path) -> None:
    colour, depth = pictures(tmp_path)
    grey = np.clip(cv2.imread(str(depth), cv2.IMREAD_UNCHANGED) / 10, 0, 255).astype(np.uint8)
    path = write(tmp_path, "grey.png", grey)
    assert starts(read(colour, path).hints) == ["depth-8-bit"]
    frame = read(colour, path, FileOptions(grey_level_m=0.01))
    assert frame.hints == ()
    np.testing.assert_allclose(frame.depth_m, grey * np.float32(0.01), rtol=1e-6)


def test_swapped_files(tmp_path: Path) -> None:
    colour, depth = pictures(tmp_path)
    assert "swapped" in starts(read(depth, colour).hints)


def test_the_same_file_twice(tmp_path: Path) -> None:
    colour, _ = pictures(tmp_path)
    assert starts(read(colour, colour).hints) == ["same-file"]
    grey = cv2.cvtColor(cv2.imread(str(colour)), cv2.COLOR_BGR2GRAY)
    assert starts(read(colour, write(tmp_path, "copy.png", grey)).hints) == ["same-file"]


def test_intrinsics_that_nobody_gave(tmp_path: Path) -> None:
    rgb = np.random.default_rng(0).integers(0, 255, (424, 512, 3), np.uint8)
    depth = np.full((424, 512), 1500, np.uint16)
    colour, depth_path = write(tmp_path, "k.png", rgb), write(tmp_path, "k_d.png", depth)
    assert starts(read(colour, depth_path).hints) == ["intrinsics"]
    lens = json.dumps({"fx": 365.0, "fy": 365.0, "cx": 256.0, "cy": 212.0})
    (tmp_path / "option.json").write_text(lens)
    given = Preparation(intrinsics=tmp_path / "option.json")
    frame = next(prepared(FilePairs([(colour, depth_path)], FileOptions()), given))
    assert frame.hints == () and frame.intrinsics.fx == 365.0
    (tmp_path / "k.json").write_text(lens)
    assert read(colour, depth_path).hints == ()
