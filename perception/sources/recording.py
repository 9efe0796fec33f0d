"""Writes frames as a recording that can be read again: a ROS bag, or a folder with time stamps.

Frames are written as the estimator saw them: rectified, depth aligned. A recording appears when it is whole; one that
ends because its source did holds what came before.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from perception.lens.calibration_files import lens_to_dict
from perception.lens.lenses import HALF_PIXEL, Lens
from perception.sources.folders import CAMERA_FILE, TUM_LISTS
from perception.sources.preparation import SourceFrame
from perception.sources.source import MissingExtraError, SourceError
from stair_env.common.images import write_image
from stair_env.intrinsics import Intrinsics

UNIT_M = 0.001  # of depth, in every kind of recording
FRAME_ID = "camera_color_optical_frame"
TOPICS = {
    "colour": "/camera/color/image_raw",
    "colour_info": "/camera/color/camera_info",
    "depth": "/camera/aligned_depth_to_color/image_raw",
    "depth_info": "/camera/aligned_depth_to_color/camera_info",
    "accel": "/camera/accel/sample",
    "gyro": "/camera/gyro/sample",
}
ROS_SUFFIXES = (".bag", ".db3", ".mcap")
PNG_COMPRESSION = 1


class Recorder(Protocol):
    """What frames are given to."""

    def add(self, frame: SourceFrame) -> None:
        """Write one frame."""


@contextlib.contextmanager
def recording(path: Path) -> Iterator[Recorder]:
    """Write a recording; it takes its place when the block ends, also when its source ended early.

    Args:
        path: `.bag` (ROS 1), `.db3` or `.mcap` (ROS 2), or a folder to make.

    Raises:
        SourceError: there is something at that path already, or the ending is none of these.
        MissingExtraError: rosbags is not installed.
    """
    if path.suffix and path.suffix.lower() not in ROS_SUFFIXES:
        raise SourceError(f"{path}: a recording is one of {', '.join(ROS_SUFFIXES)}, or a folder without ending")
    if path.exists():
        raise SourceError(f"{path} is there already; choose another name")
    path.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.stem}."))
    try:
        recorder: Any = RosRecorder(work, path.suffix.lower()) if path.suffix else FolderRecorder(work)
        try:
            yield recorder
        except SourceError:
            _finish(recorder, path)
            raise
        _finish(recorder, path)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _finish(recorder: Any, path: Path) -> None:
    finished: Path | None = recorder.finish()
    if finished is not None:
        finished.chmod(0o755 if finished.is_dir() else 0o644)
        finished.rename(path)


def samples_of(frame: SourceFrame) -> tuple[np.ndarray, np.ndarray]:
    """(k, 4) accelerometer and gyro; a gravity that was given stands in for an accelerometer at rest."""
    force, rate = frame.imu.acceleration, frame.imu.rate
    if frame.gravity_source == "given" and frame.gravity is not None:
        return np.array([[frame.time_s, *frame.gravity]]), np.zeros((0, 4))
    return force, rate


def _millimetres(depth_m: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(depth_m / UNIT_M), 0, 65535).astype(np.uint16)


class FolderRecorder:
    """A folder with time stamps, as `perception.sources.folders.TumFolder` reads it.

    Args:
        folder: to write in.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder / "set"
        self._count = 0
        self._lists = {name: "" for name in TUM_LISTS}
        for name in ("rgb", "depth"):
            (self._folder / name).mkdir(parents=True)

    def add(self, frame: SourceFrame) -> None:
        """Write one frame.

        Raises:
            OSError: it cannot be written.
        """
        if self._count == 0:
            values = {**lens_to_dict(Lens(frame.intrinsics)), "depth_scale": UNIT_M}
            (self._folder / CAMERA_FILE).write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")
        name = f"{self._count:06d}.png"
        self._write("rgb", name, frame.rgb[..., ::-1], frame.time_s)
        if frame.depth_m is not None:
            self._write("depth", name, _millimetres(frame.depth_m), frame.time_s)
        for listed, rows in zip(TUM_LISTS[2:], samples_of(frame)):
            self._lists[listed] += "".join(f"{t:.9f} {x:.9g} {y:.9g} {z:.9g}\n" for t, x, y, z in rows)
            self._flush(listed)
        self._count += 1

    def _write(self, folder: str, name: str, image: np.ndarray, time_s: float) -> None:
        path = self._folder / folder / name
        write_image(path, image, (cv2.IMWRITE_PNG_COMPRESSION, PNG_COMPRESSION))
        self._lists[f"{folder}.txt"] = f"{time_s:.9f} {folder}/{name}\n"
        self._flush(f"{folder}.txt")

    def _flush(self, listed: str) -> None:
        if self._lists[listed]:
            with (self._folder / listed).open("a", encoding="utf-8") as file:
                file.write(self._lists[listed])
            self._lists[listed] = ""

    def finish(self) -> Path | None:
        """The finished folder; None when there was no frame."""
        return self._folder if self._count else None


class RosRecorder:
    """A ROS recording, with the topics of realsense-ros.

    Args:
        folder: to write in.
        suffix: ".bag", ".db3" or ".mcap".

    Raises:
        MissingExtraError: rosbags is not installed.
    """

    def __init__(self, folder: Path, suffix: str) -> None:
        try:
            from rosbags import rosbag1, rosbag2
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise MissingExtraError(f"ROS recordings need rosbags ({error}): pip install 'stair-env[ros]'") from None
        self._ros1, self._suffix = suffix == ".bag", suffix
        self._store = get_typestore(Stores.ROS1_NOETIC if self._ros1 else Stores.ROS2_HUMBLE)
        self._path = folder / ("recording.bag" if self._ros1 else "recording")
        if self._ros1:
            self._writer: Any = rosbag1.Writer(self._path)
        else:
            plugin = rosbag2.StoragePlugin.MCAP if suffix == ".mcap" else rosbag2.StoragePlugin.SQLITE3
            self._writer = rosbag2.Writer(self._path, version=9, storage_plugin=plugin)
        self._writer.open()
        self._connections: dict[str, Any] = {}
        self._count, self._shift_s = 0, 0.0

    def finish(self) -> Path | None:
        """The finished file; None when there was no frame."""
        self._writer.close()
        if not self._count:
            return None
        return self._path if self._ros1 else next(self._path.glob(f"*{self._suffix}"))

    def add(self, frame: SourceFrame) -> None:
        """Write one frame and the IMU samples before it; times below zero, which ROS has not, are shifted."""
        samples = samples_of(frame)
        if self._count == 0:
            self._shift_s = -min(frame.time_s, 0.0, *(float(rows[0, 0]) for rows in samples if len(rows)))
        for topic, rows in zip(("accel", "gyro"), samples):
            for row in rows:
                self._put(topic, "Imu", float(row[0]), self._imu(topic, row))
        info = self._info(frame.intrinsics, frame.time_s)
        self._put("colour_info", "CameraInfo", frame.time_s, info)
        self._put("colour", "Image", frame.time_s, self._image(frame.rgb, "rgb8", frame.time_s))
        if frame.depth_m is not None:
            self._put("depth_info", "CameraInfo", frame.time_s, info)
            self._put("depth", "Image", frame.time_s, self._image(_millimetres(frame.depth_m), "16UC1", frame.time_s))
        self._count += 1

    def _put(self, topic: str, kind: str, time_s: float, message: Any) -> None:
        name = f"sensor_msgs/msg/{kind}"
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(TOPICS[topic], name, typestore=self._store)
        encode = self._store.serialize_ros1 if self._ros1 else self._store.serialize_cdr
        self._writer.write(self._connections[topic], self._nanoseconds(time_s), encode(message, name))

    def _nanoseconds(self, time_s: float) -> int:
        return max(round((time_s + self._shift_s) * 1e9), 0)

    def _type(self, name: str) -> Any:
        return self._store.types[name]

    def _header(self, time_s: float) -> Any:
        stamp = self._type("builtin_interfaces/msg/Time")(*divmod(self._nanoseconds(time_s), 1_000_000_000))
        values = {"stamp": stamp, "frame_id": FRAME_ID}
        return self._type("std_msgs/msg/Header")(**values, **({"seq": self._count} if self._ros1 else {}))

    def _image(self, image: np.ndarray, encoding: str, time_s: float) -> Any:
        data = np.ascontiguousarray(image).view(np.uint8).ravel()
        height, width = image.shape[:2]
        step = data.size // height
        return self._type("sensor_msgs/msg/Image")(self._header(time_s), height, width, encoding, 0, step, data)

    def _info(self, model: Intrinsics, time_s: float) -> Any:
        cx, cy = model.cx - HALF_PIXEL, model.cy - HALF_PIXEL
        k = np.array([model.fx, 0.0, cx, 0.0, model.fy, cy, 0.0, 0.0, 1.0])
        p = np.array([model.fx, 0.0, cx, 0.0, 0.0, model.fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0])
        whole = self._type("sensor_msgs/msg/RegionOfInterest")(0, 0, 0, 0, False)
        return self._type("sensor_msgs/msg/CameraInfo")(
            self._header(time_s),
            model.height,
            model.width,
            "plumb_bob",
            np.zeros(5),
            k,
            np.eye(3).ravel(),
            p,
            0,
            0,
            whole,
        )

    def _imu(self, sensor: str, row: np.ndarray) -> Any:
        vector, zero = self._type("geometry_msgs/msg/Vector3"), (0.0, 0.0, 0.0)
        felt = tuple(float(value) for value in row[1:])
        force, rate = (felt, zero) if sensor == "accel" else (zero, felt)
        unknown = np.zeros(9)
        unknown[0] = -1.0  # a driver's mark for what it does not measure
        level = self._type("geometry_msgs/msg/Quaternion")(0.0, 0.0, 0.0, 1.0)
        return self._type("sensor_msgs/msg/Imu")(
            self._header(float(row[0])),
            level,
            unknown,
            vector(*rate),
            np.zeros(9) if sensor == "gyro" else unknown,
            vector(*force),
            np.zeros(9) if sensor == "accel" else unknown,
        )
