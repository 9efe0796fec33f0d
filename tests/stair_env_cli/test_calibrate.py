"""`stair-env calibrate`, as a user calls it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env_cli.main import main

CAMERA = D435I_COLOR_MODES["640x480"]


def floor(folder: Path, pitch_down: float = 0.5, height: float = 0.45) -> list[str]:
    import cv2

    along = CAMERA.rays() @ np.array([0.0, math.cos(pitch_down), math.sin(pitch_down)])
    depth = np.where(along > 0.1, height / np.maximum(along, 0.1), 0.0)
    cv2.imwrite(str(folder / "rgb.png"), np.zeros((480, 640, 3), np.uint8))
    cv2.imwrite(str(folder / "depth.png"), np.rint(1000 * depth).astype(np.uint16))
    return [str(folder / "rgb.png"), str(folder / "depth.png")]


def test_a_floor_says_where_the_camera_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.json"
    words = ["calibrate", *floor(tmp_path), "--robot", "aliengo", "--trunk-height", "0.4", "--json", str(out)]
    assert main(words) == 0
    mount = json.loads(out.read_text())["mount"]
    assert abs(mount["pitch_down_rad"] - 0.5) < 2e-3 and abs(mount["roll_rad"]) < 2e-3
    assert abs(mount["height_m"] - 0.45) < 2e-3 and abs(mount["z_in_trunk_m"] - 0.05) < 2e-3
    text = capsys.readouterr().out
    assert "a floor in view" in text and "±" in text and "aliengo here" in text


def test_what_shows_no_floor_and_unknown_robots_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = floor(tmp_path)
    assert main(["calibrate", words[0]]) == 2
    assert main(["calibrate", *words, "--robot", "horse"]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 2 and "no frame" in errors[0] and "horse" in errors[1]
