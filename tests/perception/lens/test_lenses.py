"""Lenses: every distortion is undone, calibration files of every kind say the same, nonsense is named."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from perception.lens.calibration_files import CalibrationError, lens_to_dict, read_extrinsics, read_lens
from perception.lens.lenses import DISTORTIONS, Lens, Rectifier, realsense_lens, ros_lens
from stair_env.common.validation import SpecError
from stair_env.intrinsics import Intrinsics

MODEL = Intrinsics(160, 120, 150.0, 151.0, 79.0, 61.0)
BENT = {
    "brown": (0.1, -0.05, 0.002, -0.001, 0.01),
    "rational": (0.1, -0.05, 0.002, -0.001, 0.01, 0.02, 0.01, 0.0),
    "fisheye": (0.02, -0.01, 0.003, 0.0),
    "inverse_brown": (0.1, -0.05, 0.002, -0.001, 0.01),
}


def scene(rays: np.ndarray) -> np.ndarray:
    """Brightness seen along rays (..., 2): smooth, so that resampling costs little."""
    return 127.0 + 60.0 * np.sin(9.0 * rays[..., 0]) + 60.0 * np.cos(7.0 * rays[..., 1])


@pytest.mark.parametrize("name", sorted(BENT))
def test_a_bent_image_becomes_a_pinholes(name: str) -> None:
    lens = Lens(MODEL, name, BENT[name])
    rays = MODEL.rays()[..., :2]
    # What the lens puts at each pixel: the ray whose image lies there, found by fixed point from outside the class.
    ray = rays.reshape(-1, 2).copy()
    for _ in range(60):
        ray += rays.reshape(-1, 2) - lens.bent(ray)
    image = scene(ray.reshape(rays.shape))
    photo = np.repeat(np.rint(image)[..., None], 3, -1).astype(np.uint8)
    flat = Rectifier(lens).colour(photo)[..., 0].astype(float)
    inside = (slice(12, -12), slice(12, -12))
    assert np.abs(flat - scene(rays))[inside].max() < 3.0
    assert np.abs(image - scene(rays))[inside].max() > 4.0  # it was bent


def test_depth_readings_are_moved_and_never_mixed() -> None:
    depth = np.where(np.arange(160) < 80, 1.0, 3.0).astype(np.float32) * np.ones((120, 1), np.float32)
    flat = Rectifier(Lens(MODEL, "brown", BENT["brown"])).depth(depth)
    assert set(np.unique(flat)) <= {np.float32(0.0), np.float32(1.0), np.float32(3.0)}


def test_a_pinhole_is_left_alone() -> None:
    image = np.zeros((120, 160, 3), np.uint8)
    for lens in (Lens(MODEL), Lens(MODEL, "brown", (0.0,) * 5)):
        assert lens.is_pinhole and Rectifier(lens).colour(image) is image


def test_nonsense_is_named() -> None:
    with pytest.raises(SpecError, match="distortion"):
        Lens(MODEL, "barrel")
    with pytest.raises(SpecError, match="must be 4 or 5"):
        Lens(MODEL, "brown", (0.1,))
    with pytest.raises(SpecError, match="distortion_model"):
        ros_lens(160, 120, [1.0] * 9, "odd", [])
    assert "none" in DISTORTIONS


def files(folder: Path) -> dict[str, Path]:
    """The same camera in every kind of file."""
    d = list(BENT["brown"])
    k = [150.0, 0.0, 78.5, 0.0, 151.0, 60.5, 0.0, 0.0, 1.0]
    sdk = {"width": 160, "height": 120, "fx": 150.0, "fy": 151.0, "ppx": 78.5, "ppy": 60.5, "coeffs": d}
    contents = {
        "ours.json": json.dumps(lens_to_dict(Lens(MODEL, "brown", tuple(d)))),
        "sdk.json": json.dumps({**sdk, "model": "distortion.brown_conrady"}),
        "info.yaml": yaml.safe_dump({"width": 160, "height": 120, "distortion_model": "plumb_bob", "d": d, "k": k}),
        "ros1.yaml": yaml.safe_dump(
            {
                "image_width": 160,
                "image_height": 120,
                "distortion_model": "plumb_bob",
                "camera_matrix": {"rows": 3, "cols": 3, "data": k},
                "distortion_coefficients": {"rows": 1, "cols": 5, "data": d},
            }
        ),
    }
    for name, text in contents.items():
        (folder / name).write_text(text)
    return {name: folder / name for name in contents}


def test_all_files_say_the_same(tmp_path: Path) -> None:
    for path in files(tmp_path).values():
        assert read_lens(path, 160, 120) == Lens(MODEL, "brown", BENT["brown"]), path
        assert read_lens(path, 320, 240).intrinsics == MODEL.scaled(320, 240)
        with pytest.raises(CalibrationError, match="160x120 images, these are 160x90"):
            read_lens(path, 160, 90)


def test_the_sdks_own_objects(tmp_path: Path) -> None:
    values = SimpleNamespace(
        width=160, height=120, fx=150.0, fy=151.0, ppx=78.5, ppy=60.5, model="distortion.inverse_brown_conrady"
    )
    values.coeffs = [0.0] * 5
    assert realsense_lens(values) == Lens(MODEL)
    values.coeffs = list(BENT["inverse_brown"])
    assert realsense_lens(values) == Lens(MODEL, "inverse_brown", BENT["inverse_brown"])


@pytest.mark.parametrize("text", ["[1]", "{", '{"fx": 1}', '{"fx": 0, "fy": 0, "cx": 0, "cy": 0}', '{"K": [1, 2]}'])
def test_a_file_that_is_none_is_named(text: str, tmp_path: Path) -> None:
    path = tmp_path / "lens.json"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=r"lens\.json"):
        read_lens(path, 160, 120)


def test_extrinsics(tmp_path: Path) -> None:
    path = tmp_path / "pose.json"
    path.write_text(json.dumps({"rotation": np.eye(3).tolist(), "translation": [0.015, 0.0, 0.0]}))
    assert read_extrinsics(path)[0, 3] == 0.015
    for wrong in (
        {"rotation": [1] * 9, "translation": [0, 0, 0]},
        {"rotation": np.eye(3).tolist(), "translation": [15.0, 0.0, 0.0]},
        {"translation": [0, 0, 0]},
    ):
        path.write_text(json.dumps(wrong))
        with pytest.raises(CalibrationError, match=r"pose\.json"):
            read_extrinsics(path)
