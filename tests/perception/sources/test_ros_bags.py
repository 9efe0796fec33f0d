"""ROS recordings that are not ours: other encodings, missing topics, cut short files. Bags are written by rosbags."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from perception.sources.opening import open_source
from perception.sources.preparation import Preparation, prepared
from perception.sources.recording import RosRecorder, recording
from perception.sources.ros_bags import BagTopics, RosBag
from perception.sources.source import (
    BrokenRecordingError,
    MissingImuError,
    MissingTopicError,
    UnalignedDepthError,
)
from tests.perception.sources.conftest import ListSource, drawn

pytest.importorskip("rosbags", reason="ROS recordings need the extra stair-env[ros]")


class Bag:
    """A ROS 2 recording, message by message."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self._recorder, self._folder = RosRecorder(folder, ".mcap"), folder
        self._made: dict[str, Any] = {}
        self.frame = next(prepared(ListSource(drawn(1))))

    def put(self, topic: str, kind: str, message: Any, time_s: float = 10.0) -> None:
        r = self._recorder
        if topic not in self._made:
            self._made[topic] = r._writer.add_connection(topic, f"sensor_msgs/msg/{kind}", typestore=r._store)
        r._writer.write(
            self._made[topic], round(time_s * 1e9), r._store.serialize_cdr(message, f"sensor_msgs/msg/{kind}")
        )

    def info(self, topic: str, frame_id: str = "colour") -> None:
        message = self._recorder._info(self.frame.intrinsics, 10.0)
        message.header.frame_id = frame_id
        self.put(topic, "CameraInfo", message)

    def image(self, topic: str, image: np.ndarray, encoding: str, time_s: float = 10.0) -> None:
        self.put(topic, "Image", self._recorder._image(image, encoding, time_s), time_s)

    def compressed(self, topic: str, data: bytes, form: str) -> None:
        r = self._recorder
        message = r._type("sensor_msgs/msg/CompressedImage")(r._header(10.0), form, np.frombuffer(data, np.uint8))
        self.put(topic, "CompressedImage", message)

    def close(self) -> Path:
        self._recorder._count = 1
        path = self._recorder.finish()
        assert path is not None
        return path


def test_compressed_images_are_read(tmp_path: Path) -> None:
    bag = Bag(tmp_path / "b")
    rgb, depth = bag.frame.rgb, bag.frame.depth_m
    bag.info("/cam/color/camera_info")
    png = cv2.imencode(".png", rgb[..., ::-1])[1].tobytes()
    bag.compressed("/cam/color/image_raw/compressed", png, "png")
    packed = bytes(12) + cv2.imencode(".png", np.rint(1000 * depth).astype(np.uint16))[1].tobytes()
    bag.compressed("/cam/aligned_depth_to_color/image_raw/compressedDepth", packed, "16UC1; compressedDepth png")
    frame = next(prepared(open_source([bag.close()])))
    np.testing.assert_array_equal(frame.rgb, rgb)
    np.testing.assert_allclose(frame.depth_m, depth, atol=1e-6)
    assert frame.gravity is None and frame.gravity_source == "none"


@pytest.mark.parametrize("encoding", ["bgr8", "rgba8"])
def test_other_colour_encodings_and_floating_depth(encoding: str, tmp_path: Path) -> None:
    bag = Bag(tmp_path / "b")
    rgb, depth = bag.frame.rgb, bag.frame.depth_m.copy()
    given = rgb[..., ::-1] if encoding == "bgr8" else np.dstack([rgb, np.full(rgb.shape[:2], 255, np.uint8)])
    bag.info("/cam/color/camera_info")
    bag.image("/cam/color/image_raw", given, encoding)
    depth[:5] = np.nan
    bag.image("/cam/aligned_depth_to_color/image_raw", depth, "32FC1")
    frame = next(prepared(open_source([bag.close()])))
    np.testing.assert_array_equal(frame.rgb, rgb)
    assert not frame.depth_m[:5].any()
    np.testing.assert_allclose(frame.depth_m[5:], depth[5:])


def test_depth_of_another_camera_is_refused_unless_extrinsics_are_given(tmp_path: Path) -> None:
    bag = Bag(tmp_path / "b")
    bag.info("/cam/color/camera_info")
    bag.image("/cam/color/image_raw", bag.frame.rgb, "rgb8")
    bag.info("/cam/depth/camera_info", "depth")
    bag.image("/cam/depth/image_rect_raw", np.rint(1000 * bag.frame.depth_m).astype(np.uint16), "16UC1")
    path = bag.close()
    with pytest.raises(UnalignedDepthError, match="--extrinsics"):
        next(prepared(open_source([path])))
    pose = tmp_path / "pose.json"
    pose.write_text('{"rotation": [1, 0, 0, 0, 1, 0, 0, 0, 1], "translation": [0.0, 0.0, 0.0]}')
    frame = next(prepared(open_source([path]), Preparation(extrinsics=pose)))
    np.testing.assert_allclose(frame.depth_m, bag.frame.depth_m, atol=1e-6)


def test_colourised_depth_is_an_error_that_says_so(tmp_path: Path) -> None:
    bag = Bag(tmp_path / "b")
    bag.info("/cam/color/camera_info")
    bag.image("/cam/color/image_raw", bag.frame.rgb, "rgb8")
    bag.image("/cam/aligned_depth_to_color/image_raw", bag.frame.rgb, "rgb8")
    with pytest.raises(ValueError, match="coloured picture of depth"):
        next(iter(open_source([bag.close()])))


def test_a_missing_topic_is_named_with_those_there_are(tmp_path: Path) -> None:
    bag = Bag(tmp_path / "b")
    bag.info("/cam/color/camera_info")
    bag.image("/cam/aligned_depth_to_color/image_raw", bag.frame.rgb[..., 0], "mono8")
    path = bag.close()
    with pytest.raises(MissingTopicError, match=r"no topic with colour images; it has .*/cam/color/camera_info"):
        RosBag(path)
    with pytest.raises(MissingTopicError, match="'/nowhere'"):
        RosBag(path, BagTopics(colour="/nowhere"))
    with pytest.raises(MissingImuError, match="Imu"):
        RosBag(path, BagTopics(colour="/cam/aligned_depth_to_color/image_raw"), need_imu=True)


def test_images_without_camera_info_say_so(tmp_path: Path) -> None:
    bag = Bag(tmp_path / "b")
    bag.image("/cam/color/image_raw", bag.frame.rgb, "rgb8")
    with pytest.raises(MissingTopicError, match="camera_info"):
        list(open_source([bag.close()]))


def test_colour_and_depth_that_never_meet_say_so(tmp_path: Path) -> None:
    bag = Bag(tmp_path / "b")
    bag.info("/cam/color/camera_info")
    bag.image("/cam/color/image_raw", bag.frame.rgb, "rgb8", 10.0)
    bag.image("/cam/aligned_depth_to_color/image_raw", np.ones(bag.frame.rgb.shape[:2], np.uint16), "16UC1", 11.0)
    with pytest.raises(MissingTopicError, match="1 colour and 1 depth images, and no two within 20 ms"):
        list(open_source([bag.close()]))


@pytest.mark.parametrize("kind", [".bag", ".db3", ".mcap"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_file_cut_short_is_a_named_error(kind: str, share: float, tmp_path: Path) -> None:
    path = tmp_path / f"walk{kind}"
    with recording(path) as recorder:
        for frame in prepared(ListSource(drawn())):
            recorder.add(frame)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises((BrokenRecordingError, MissingTopicError), match=f"walk{kind}"):
        list(open_source([path]))
