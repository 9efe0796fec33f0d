"""ROS recordings without ROS: `.bag` of ROS 1, `.db3` and `.mcap` of ROS 2, through rosbags (`stair-env[ros]`)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from perception.lens.calibration_files import rigid
from perception.lens.lenses import Lens
from perception.sources.ros_messages import colour_of, depth_of, extrinsics_of, imu_of, lens_of, stamp_s
from perception.sources.source import (
    BrokenRecordingError,
    ImuSamples,
    MissingExtraError,
    MissingImuError,
    MissingTopicError,
    RawFrame,
    SourceError,
    no_samples,
)

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
INFO, IMU = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Imu"
EXTRINSICS = "realsense2_camera_msgs/msg/Extrinsics"
MAX_APART_S = 0.02  # between the stamps of colour and depth of one frame: more than half a frame at 30 a second
WAITING = 8  # images that wait for their other half; older ones never get one


@dataclass(frozen=True)
class BagTopics:
    """Topics that are read; None: the one that looks like it.

    Attributes:
        colour, depth: image topics, raw or compressed.
        imu: topics with Imu messages; () takes what there is.
    """

    colour: str | None = None
    depth: str | None = None
    imu: tuple[str, ...] = ()


class RosBag:
    """Frames of a ROS recording.

    Args:
        path: a `.bag`, `.db3` or `.mcap` file, or the folder of a ROS 2 recording.
        topics: which topics.
        need_imu: refuse a recording without IMU.

    Raises:
        MissingExtraError: rosbags is not installed.
        BrokenRecordingError: the file is cut short or no recording.
        MissingTopicError, MissingImuError: it lacks what is needed; the message lists its topics.
    """

    def __init__(self, path: Path, topics: BagTopics = BagTopics(), need_imu: bool = False) -> None:
        self._path, self._reader = path, _open(path)
        try:
            self._choose(topics)
            if need_imu and not self._imu:
                raise MissingImuError(f"{path}: has no {IMU} topic; it has {self._listed()}")
        except SourceError:
            self.close()
            raise

    def _choose(self, topics: BagTopics) -> None:
        images = {c.topic for c in self._reader.connections if c.msgtype in (IMAGE, COMPRESSED)}
        depths = {topic for topic in images if "depth" in topic.lower()}
        self._colour = self._pick("colour", topics.colour, images - depths, ("color", "colour", "rgb", "image"))
        if topics.depth is not None or depths:
            self._depth: str | None = self._pick("depth", topics.depth, depths, ("aligned", "depth"))
        else:
            self._depth = None
        imus = sorted(c.topic for c in self._reader.connections if c.msgtype == IMU)
        missing = [topic for topic in topics.imu if topic not in imus]
        if missing:
            raise MissingTopicError(f"{self._path}: has no {IMU} topic {missing[0]!r}; it has {self._listed()}")
        # A topic that unites both sensors makes those of each superfluous.
        united = [topic for topic in imus if topic.rstrip("/").endswith("imu")]
        self._imu = topics.imu or tuple(united[:1] or imus)

    def _pick(self, what: str, asked: str | None, choices: set[str], words: Sequence[str]) -> str:
        if asked is not None:
            if asked not in {c.topic for c in self._reader.connections}:
                raise MissingTopicError(f"{self._path}: has no topic {asked!r}; it has {self._listed()}")
            return asked

        def rank(topic: str) -> tuple[int, int, str]:
            hit = next((i for i, word in enumerate(words) if word in topic.lower()), len(words))
            return hit, int("compressed" in topic.lower()), topic

        found = sorted((topic for topic in choices if "infra" not in topic and rank(topic)[0] < len(words)), key=rank)
        if not found:
            raise MissingTopicError(f"{self._path}: has no topic with {what} images; it has {self._listed()}")
        return found[0]

    def _listed(self) -> str:
        return ", ".join(f"{c.topic} ({c.msgtype})" for c in self._reader.connections) or "no topics"

    @property
    def name(self) -> str:
        """The file."""
        return str(self._path)

    @property
    def topics(self) -> BagTopics:
        """What is read."""
        return BagTopics(self._colour, self._depth, self._imu)

    def __len__(self) -> int:
        """How many colour images."""
        return int(self._reader.topics[self._colour].msgcount)

    def close(self) -> None:
        """Close the file; safe to call twice."""
        if self._reader.stack is not None:
            self._reader.close()

    def __iter__(self) -> Iterator[RawFrame]:
        """Colour images with the depth of the same time.

        Raises:
            BrokenRecordingError: the file ends early or is damaged.
            MissingTopicError: an image comes without the `camera_info` that belongs to it, or none gets its other half.
        """
        joiner = _Joiner(self._path, self._colour, self._depth, set(self._imu))
        infos = {_info_topic(topic) for topic in (self._colour, self._depth) if topic}
        wanted = {self._colour, self._depth, *self._imu, *infos}
        chosen = [c for c in self._reader.connections if c.topic in wanted or c.msgtype == EXTRINSICS]
        joiner.expects_depth_info = self._depth is not None and _info_topic(self._depth) in {c.topic for c in chosen}
        for connection, message in _messages(self._reader, chosen, joiner):
            frame = joiner.take(connection, message)
            if frame is not None:
                yield frame
        joiner.finish()


def _open(path: Path) -> Any:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingExtraError(f"ROS recordings need rosbags ({error}): pip install 'stair-env[ros]'") from None
    if not path.exists():
        raise SourceError(f"{path}: no such file or folder")
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    except Exception as error:  # a damaged file can raise anything from the library
        cause = " ".join(str(error).split()) or type(error).__name__
        raise BrokenRecordingError(
            f"{path}: cannot be opened as a ROS recording: {cause}; was it cut short? `rosbag reindex`, "
            "`ros2 bag reindex` or `mcap recover` save what is there"
        ) from None
    return reader


def _messages(reader: Any, chosen: Iterable[Any], joiner: _Joiner) -> Iterator[tuple[Any, Any]]:
    """Messages in the order they were recorded."""
    chosen = list(chosen)
    messages = reader.messages(connections=chosen) if chosen else iter(())
    while True:
        try:
            connection, _, data = next(messages)
            message = reader.deserialize(data, connection.msgtype)
        except StopIteration:
            return
        except Exception as error:  # see _open
            cause = " ".join(str(error).split()) or type(error).__name__
            raise BrokenRecordingError(
                f"{joiner.path}: cut short or damaged after {joiner.given} frames: {cause}"
            ) from None
        yield connection, message


def _info_topic(image_topic: str) -> str:
    """`camera_info` beside an image topic."""
    base = image_topic
    for ending in ("/compressedDepth", "/compressed"):
        base = base.removesuffix(ending)
    return base.rpartition("/")[0] + "/camera_info"


class _Joiner:
    """Puts messages together to frames.

    Attributes:
        path: of the recording.
        given: frames so far.
        expects_depth_info: whether depth has a `camera_info` of its own, without which it is taken to be aligned.
    """

    def __init__(self, path: Path, colour: str, depth: str | None, imu: set[str]) -> None:
        self.path, self.given, self.expects_depth_info = path, 0, False
        self._topics = {colour: "colour", _info_topic(colour): "colour_info"}
        if depth is not None:
            self._topics[depth] = "depth"
            self._topics.setdefault(_info_topic(depth), "depth_info")
        self._has_depth, self._imu_topics = depth is not None, imu
        self._aligned_name = depth is not None and "aligned" in depth
        self._waiting: dict[str, deque[Any]] = {name: deque(maxlen=WAITING) for name in ("colour", "depth")}
        self._seen = {"colour": 0, "depth": 0}
        self._lens: Lens | None = None
        self._depth_lens: Lens | None = None
        self._frames = {"colour": "", "depth": ""}
        self._pose: np.ndarray | None = None
        self._samples: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])

    def take(self, connection: Any, message: Any) -> RawFrame | None:
        """A message; the frame that it completes, if it does."""
        if connection.topic in self._imu_topics:
            for rows, sample in zip(self._samples, imu_of(message)):
                if sample is not None:
                    rows.append(sample)
            return None
        if connection.msgtype == EXTRINSICS:
            if "depth_to_color" in connection.topic:
                self._pose = rigid(*extrinsics_of(message), connection.topic)
            return None
        kind = self._topics[connection.topic]
        if kind == "colour_info":
            self._lens, self._frames["colour"] = lens_of(message), str(message.header.frame_id)
            return self._match(None)
        if kind == "depth_info":
            self._depth_lens, self._frames["depth"] = lens_of(message), str(message.header.frame_id)
            return self._match(None)
        self._waiting[kind].append(message)
        self._seen[kind] += 1
        return self._match(kind)

    def _ready(self) -> bool:
        return self._lens is not None and (self._depth_lens is not None or not self.expects_depth_info)

    def _match(self, kind: str | None) -> RawFrame | None:
        """The oldest colour image whose depth is there, or could not come any more."""
        if not self._ready() or not self._waiting["colour"]:
            return None
        if not self._has_depth:
            return self._frame(self._waiting["colour"].popleft(), None)
        for colour in self._waiting["colour"]:
            time_s = stamp_s(colour)
            near = [d for d in self._waiting["depth"] if abs(stamp_s(d) - time_s) <= MAX_APART_S]
            if near:
                depth = min(near, key=lambda d: abs(stamp_s(d) - time_s))
                for name, until in (("colour", time_s), ("depth", stamp_s(depth))):
                    while self._waiting[name] and stamp_s(self._waiting[name][0]) <= until:
                        self._waiting[name].popleft()
                return self._frame(colour, depth)
        return None

    def _frame(self, colour: Any, depth: Any | None) -> RawFrame:
        assert self._lens is not None
        own = self.expects_depth_info and not self._aligned_name and self._frames["depth"] != self._frames["colour"]
        forces, rates = (np.array(rows) if rows else no_samples() for rows in self._samples)
        self._samples = ([], [])
        frame = RawFrame(
            name=f"frame_{self.given:06d}",
            time_s=stamp_s(colour),
            rgb=colour_of(colour),
            depth_m=None if depth is None else depth_of(depth),
            lens=self._lens,
            depth_lens=self._depth_lens if own and depth is not None else None,
            depth_to_colour=self._pose,
            imu=ImuSamples(forces, rates),
        )
        self.given += 1
        return frame

    def finish(self) -> None:
        """The recording has ended.

        Raises:
            MissingTopicError: there were images and not one frame came of them.
        """
        if self.given or not self._seen["colour"]:
            return
        if not self._ready():
            raise MissingTopicError(f"{self.path}: images come without camera_info, so their focal length is not known")
        raise MissingTopicError(
            f"{self.path}: {self._seen['colour']} colour and {self._seen['depth']} depth images, and no two within "
            f"{1000 * MAX_APART_S:.0f} ms of each other"
        )
