"""Through the real SDK: rendered frames in by `rs.software_device`, the same frames out, live and played back."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perception.lens.alignment import align_depth
from perception.sources.opening import made_by_sdk, open_source
from perception.sources.preparation import prepared
from perception.sources.realsense import RealSense, RealSenseOptions, open_device
from perception.sources.source import BrokenRecordingError, DeviceLostError, MissingImuError, RawFrame, SourceError
from stair_env.intrinsics import Intrinsics
from tests.perception.sources.conftest import CAMERA, drawn

rs = pytest.importorskip(
    "pyrealsense2", reason="RealSense devices need the extra stair-env[realsense]", exc_type=ImportError
)


class SoftwareDevice:
    """A device of the SDK's that shows given frames.

    Args:
        imu: whether it has an accelerometer and a gyro.
        depth: intrinsics of the depth camera.
        offset_m: of the colour camera from the depth camera, to the left.
    """

    def __init__(self, imu: bool = True, depth: Intrinsics = CAMERA, offset_m: float = 0.0) -> None:
        self.device = rs.software_device()
        self._colour_sensor = self.device.add_sensor("RGB Camera")
        self._depth_sensor = self.device.add_sensor("Stereo Module")
        self._colour = self._colour_sensor.add_video_stream(_video(rs.stream.color, 1, rs.format.rgb8, CAMERA, 3), True)
        self._depth = self._depth_sensor.add_video_stream(_video(rs.stream.depth, 2, rs.format.z16, depth, 2), True)
        self._depth_sensor.add_read_only_option(rs.option.depth_units, 0.001)
        pose = rs.extrinsics()
        pose.rotation, pose.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [offset_m, 0.0, 0.0]
        self._depth.register_extrinsics_to(self._colour, pose)
        self._motion: dict[str, Any] = {}
        if imu:
            self._motion_sensor = self.device.add_sensor("Motion Module")
            for uid, kind, rate in ((3, rs.stream.accel, 250), (4, rs.stream.gyro, 200)):
                stream = rs.motion_stream()
                stream.type, stream.index, stream.uid, stream.fps, stream.fmt = (
                    kind,
                    0,
                    uid,
                    rate,
                    rs.format.motion_xyz32f,
                )
                self._motion[kind.name] = self._motion_sensor.add_motion_stream(stream, True)

    def show(self, frames: tuple[RawFrame, ...], pause_s: float = 0.0) -> None:
        for number, frame in enumerate(frames):
            if self._motion:
                for name, rows in (("accel", frame.imu.acceleration), ("gyro", frame.imu.rate)):
                    for row in rows:
                        self._show_motion(name, row, number)
            depth = np.rint(1000 * frame.depth_m).astype(np.uint16)
            stamp = 1000.0 * frame.time_s
            self._show_video(self._colour_sensor, self._colour, frame.rgb, 3, stamp, number)
            self._show_video(self._depth_sensor, self._depth, depth, 2, stamp, number)
            time.sleep(pause_s)

    def _show_motion(self, name: str, row: np.ndarray, number: int) -> None:
        sample = rs.software_motion_frame()
        sample.data = rs.vector()
        sample.data.x, sample.data.y, sample.data.z = (float(value) for value in row[1:])
        vector = rs.vector()
        vector.x, vector.y, vector.z = (float(value) for value in row[1:])
        sample.data = vector
        sample.timestamp, sample.domain, sample.frame_number = (
            1000.0 * row[0],
            rs.timestamp_domain.hardware_clock,
            number,
        )
        sample.profile = self._motion[name].as_motion_stream_profile()
        self._motion_sensor.on_motion_frame(sample)

    def _show_video(self, sensor: Any, profile: Any, image: np.ndarray, bpp: int, stamp: float, number: int) -> None:
        frame = rs.software_video_frame()
        frame.pixels, frame.bpp, frame.stride = np.ascontiguousarray(image), bpp, image.shape[1] * bpp
        frame.timestamp, frame.domain, frame.frame_number = stamp, rs.timestamp_domain.hardware_clock, number
        frame.profile = profile.as_video_stream_profile()
        if bpp == 2:
            frame.depth_units = 0.001
        sensor.on_video_frame(frame)


def _video(kind: Any, uid: int, form: Any, model: Intrinsics, bpp: int) -> Any:
    stream, lens = rs.video_stream(), rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy = model.width, model.height, model.fx, model.fy
    lens.ppx, lens.ppy, lens.model, lens.coeffs = model.cx - 0.5, model.cy - 0.5, rs.distortion.brown_conrady, [0.0] * 5
    stream.type, stream.index, stream.uid, stream.fmt, stream.intrinsics = kind, 0, uid, form, lens
    stream.width, stream.height, stream.fps, stream.bpp = model.width, model.height, 30, bpp
    return stream


def read_live(
    device: SoftwareDevice, frames: tuple[RawFrame, ...], options: RealSenseOptions, target: Any = None
) -> list[RawFrame]:
    """What comes out while the device shows frames; `target` records beside."""
    source = RealSense(target if target is not None else device.device, "software", options)
    found: list[RawFrame] = []
    iterator = iter(source)
    shower = threading.Thread(target=lambda: (time.sleep(0.3), device.show(frames, 0.05)))
    shower.start()
    for frame in iterator:
        found.append(frame)
        if len(found) == len(frames):
            break
    shower.join()
    source.close()
    return found


OPTIONS = RealSenseOptions(CAMERA.width, CAMERA.height, timeout_s=5.0)


def assert_same(found: list[RawFrame], shown: tuple[RawFrame, ...]) -> None:
    assert len(found) == len(shown)
    for a, b in zip(found, shown):
        np.testing.assert_array_equal(a.rgb, b.rgb)
        np.testing.assert_allclose(a.depth_m, b.depth_m, atol=1e-6)
        np.testing.assert_allclose(
            [a.lens.intrinsics.fx, a.lens.intrinsics.cx, a.lens.intrinsics.cy],
            [CAMERA.fx, CAMERA.cx, CAMERA.cy],
            atol=1e-4,
        )
        assert abs(a.time_s - b.time_s) < 1e-6


def test_live_recorded_and_played_back_are_what_was_shown(tmp_path: Path) -> None:
    device, path = SoftwareDevice(), tmp_path / "walk.db3"
    recorder = rs.recorder(str(path), device.device)
    live = read_live(device, drawn(), OPTIONS, recorder)
    assert_same(live, drawn())
    assert sum(len(frame.imu.acceleration) for frame in live) >= 25
    del recorder
    assert made_by_sdk(path)
    source = open_source([path])
    played = list(source)
    source.close()
    assert_same(played, drawn())
    for a, b in zip(prepared_list(played), prepared_list(list(drawn()))):
        assert a.gravity_source == b.gravity_source == "imu"
        angle = np.arccos(np.clip(a.gravity @ b.gravity / np.linalg.norm(a.gravity) / np.linalg.norm(b.gravity), -1, 1))
        assert np.degrees(angle) < 0.1


def prepared_list(frames: list[RawFrame]) -> list[Any]:
    from tests.perception.sources.conftest import ListSource

    return list(prepared(ListSource(tuple(frames))))


def test_the_sdk_aligns_depth_as_we_do() -> None:
    depth = Intrinsics(320, 240, 191.0, 191.0, 160.0, 120.0)
    device = SoftwareDevice(imu=False, depth=depth, offset_m=0.015)
    plane = np.full((240, 320), 1.5, np.float32)
    shown = (RawFrame("a", 1.0, drawn()[0].rgb, plane, drawn()[0].lens),)
    found = read_live(device, shown, OPTIONS)[0].depth_m
    pose = np.eye(4)
    pose[0, 3] = 0.015
    ours = align_depth(plane, depth, pose, CAMERA)
    both = (found > 0) & (ours > 0)
    assert both.mean() > 0.9
    np.testing.assert_allclose(found[both], ours[both], atol=1e-3)


def test_filters_keep_size_and_scale() -> None:
    found = read_live(SoftwareDevice(imu=False), drawn(1), RealSenseOptions(320, 240, filters=True))[0]
    shown = drawn()[0].depth_m
    good = (found.depth_m > 0) & (shown > 0)
    assert np.median(np.abs(found.depth_m - shown)[good]) < 0.005


def test_a_silent_device_is_lost_and_what_came_is_kept() -> None:
    device = SoftwareDevice(imu=False)
    source = RealSense(device.device, "software", RealSenseOptions(320, 240, timeout_s=1.0))
    found = []
    shower = threading.Thread(target=lambda: (time.sleep(0.2), device.show(drawn(2), 0.02)))
    shower.start()
    with pytest.raises(DeviceLostError, match="after 2 frames"):
        for frame in source:
            found.append(frame)
    shower.join()
    assert len(found) == 2


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(MissingImuError, match="accelerometer"):
        RealSense(SoftwareDevice(imu=False).device, "software", RealSenseOptions(320, 240, need_imu=True))
    with pytest.raises(SourceError, match=r"RealSense.*found"):
        open_device("no-such-number")
    device, path = SoftwareDevice(imu=False), tmp_path / "walk.db3"
    recorder = rs.recorder(str(path), device.device)
    read_live(device, drawn(2), OPTIONS, recorder)
    del recorder
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 3])
    with pytest.raises(BrokenRecordingError, match=r"walk\.db3"):
        list(open_source([path]))
