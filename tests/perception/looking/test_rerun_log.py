"""Recordings for the Rerun viewer: frames come out of the file again; without the library the error says what to do."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from perception.estimator import StairEstimator
from perception.looking.frame_measurement import measure_frame
from perception.looking.rerun_log import camera_to_upright, cloud, rerun_log, treads
from perception.sources.preparation import Preparer
from perception.sources.source import MissingExtraError
from tests.perception.sources.conftest import CAMERA, drawn


class Nothing:
    """A detector that finds nothing."""

    def detect(self, rgb: Sequence[np.ndarray], depth_m: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((len(rgb), 32, 16)), np.zeros((len(rgb), 32, 16, 8))


def test_frames_and_blueprint_are_in_the_file(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="recordings for Rerun need the extra stair-env[rerun]")
    path, estimator, preparer = tmp_path / "walk.rrd", StairEstimator(detector=Nothing()), Preparer()
    with rerun_log(path) as log:
        for raw in drawn(2):
            log.add(measure_frame(estimator, preparer.prepare(raw)))
    data = path.read_bytes()
    for name in (b"world/camera/image", b"world/camera/depth", b"world/cloud", b"blueprint"):
        assert name in data, name
    assert [item.name for item in tmp_path.iterdir()] == ["walk.rrd"]


def test_without_the_library_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match=r"stair-env\[rerun\]"), rerun_log(tmp_path / "a.rrd"):
        pass
    assert not list(tmp_path.iterdir())


def test_a_level_frame_stands_upright() -> None:
    np.testing.assert_allclose(
        camera_to_upright(np.array([0.0, -9.8, 0.0])), [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-9
    )
    raw = drawn(1)[0]
    assert raw.depth_m is not None
    points, colours = cloud(raw.rgb, raw.depth_m, CAMERA.rays())
    gravity = raw.imu.acceleration[-1, 1:]
    heights = (points @ camera_to_upright(gravity).T)[:, 2]
    assert len(points) == len(colours) > 500
    assert abs(np.quantile(heights, 0.02) + 0.9) < 0.03  # the floor under a camera at 0.9 m


def test_nothing_measured_draws_nothing() -> None:
    from perception.geometry.results import StairEstimate

    assert treads(StairEstimate(valid=False)) == []
