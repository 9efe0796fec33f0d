"""Round trips: what is recorded comes back, by ROS 1, ROS 2 and folders; nothing half-written is left."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from perception.sources.opening import open_source
from perception.sources.preparation import Preparation, SourceFrame, prepared
from perception.sources.recording import recording
from perception.sources.simulated import SimulatedSource
from perception.sources.source import BrokenRecordingError, SourceError
from tests.perception.sources.conftest import ListSource, drawn


def kinds() -> list[str]:
    return ["walk", "walk.bag", "walk.db3", "walk.mcap"]


def needs(kind: str) -> None:
    if "." in kind:
        pytest.importorskip("rosbags", reason="ROS recordings need the extra stair-env[ros]")


def write(path: Path, preparation: Preparation | None = None) -> list[SourceFrame]:
    frames = list(prepared(ListSource(drawn()), preparation or Preparation()))
    with recording(path) as recorder:
        for frame in frames:
            recorder.add(frame)
    return frames


@pytest.mark.parametrize("kind", kinds())
def test_what_is_recorded_comes_back(kind: str, tmp_path: Path) -> None:
    needs(kind)
    written = write(tmp_path / kind)
    source = open_source([tmp_path / kind])
    read = list(prepared(source))
    source.close()
    assert len(read) == len(written) == len(source if kind == "walk" else written)
    for a, b in zip(written, read):
        np.testing.assert_array_equal(a.rgb, b.rgb)
        np.testing.assert_allclose(a.depth_m, b.depth_m, atol=1e-6)
        assert b.intrinsics == a.intrinsics
        assert abs(a.time_s - b.time_s) < 1e-6
        assert b.gravity_source == "imu"
        np.testing.assert_allclose(a.gravity, b.gravity, atol=0.02)
    assert [item.name for item in tmp_path.iterdir()] == [kind]


@pytest.mark.parametrize("kind", kinds())
def test_a_given_gravity_survives(kind: str, tmp_path: Path) -> None:
    needs(kind)
    write(tmp_path / kind, Preparation(gravity=(1.0, -9.0, -3.0)))
    frame = list(prepared(open_source([tmp_path / kind])))[-1]
    direction = np.array([1.0, -9.0, -3.0]) / np.linalg.norm([1.0, -9.0, -3.0])
    assert frame.gravity is not None
    np.testing.assert_allclose(frame.gravity / np.linalg.norm(frame.gravity), direction, atol=1e-4)


@pytest.mark.parametrize("kind", kinds())
def test_a_source_that_breaks_off_leaves_what_came_before(kind: str, tmp_path: Path) -> None:
    needs(kind)
    with pytest.raises(BrokenRecordingError), recording(tmp_path / kind) as recorder:
        for frame in prepared(ListSource(drawn()[:2], BrokenRecordingError("cut short"))):
            recorder.add(frame)
    assert len(list(open_source([tmp_path / kind]))) == 2


@pytest.mark.parametrize("kind", kinds())
def test_a_walk_of_the_simulated_camera_measures_gravity_again(kind: str, tmp_path: Path) -> None:
    """Its clock begins below zero, frames come late, and the robot walks on at once."""
    needs(kind)
    walk = list(prepared(SimulatedSource(4, camera={"width": 320})))
    with recording(tmp_path / kind) as recorder:
        for frame in walk:
            recorder.add(frame)
    for a, b in zip(walk, prepared(open_source([tmp_path / kind])), strict=True):
        assert a.gravity is not None and b.gravity is not None
        cosine = a.gravity @ b.gravity / np.linalg.norm(a.gravity) / np.linalg.norm(b.gravity)
        assert np.degrees(np.arccos(min(cosine, 1.0))) < 0.5


def test_a_bug_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), recording(tmp_path / "walk") as recorder:
        recorder.add(next(prepared(ListSource(drawn()))))
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())


def test_names_are_checked(tmp_path: Path) -> None:
    (tmp_path / "walk").mkdir()
    with pytest.raises(SourceError, match="is there already"), recording(tmp_path / "walk"):
        pass
    with pytest.raises(SourceError, match=r"\.mcap"), recording(tmp_path / "walk.mp4"):
        pass
