"""Joins what a RealSense's streams bring, each by itself, to RGB-D frames with the IMU samples before them."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from perception.lens.lenses import Lens, realsense_lens
from perception.sources.source import ImuSamples, RawFrame, no_samples

MAX_APART_S = 0.017  # between colour and depth of one frame: half a frame at 30 a second
WAITING = 4  # images that wait for their other half
HELD = 16  # RGB-D frames of a recording that wait for the accelerometer
IMU_KEPT = 4000  # samples between two frames: ten seconds


class FrameJoiner:
    """Joins colour and depth of one time, aligned by the SDK.

    Args:
        sdk: pyrealsense2.
        profiles: stream -> (sensor, profile).
        filters: whether depth goes through the SDK's post-processing.
        holds: a recording's streams come by threads of their own: frames wait until the accelerometer has come as far.
    """

    def __init__(self, sdk: Any, profiles: dict[str, tuple[Any, Any]], filters: bool, holds: bool = False) -> None:
        self._sdk = sdk
        self._holds = holds and "accel" in profiles
        self._pairs: deque[tuple[Any, Any]] = deque()
        self._waiting: dict[str, deque[Any]] = {name: deque(maxlen=WAITING) for name in ("color", "depth")}
        self._samples: dict[str, deque[list[float]]] = {name: deque(maxlen=IMU_KEPT) for name in ("accel", "gyro")}
        colour, depth = profiles["color"][1], profiles["depth"][1]
        self._lens = realsense_lens(colour.as_video_stream_profile().get_intrinsics())
        self._align = None if self._is_aligned(colour, depth) else sdk.align(sdk.stream.color)
        self._filters = _post_processing(sdk) if filters else []
        self._pair: list[Any] = []
        self._composer = sdk.processing_block(self._compose)
        self._composed = sdk.frame_queue(1)
        self._composer.start(self._composed)

    def _is_aligned(self, colour: Any, depth: Any) -> bool:
        own: Lens = realsense_lens(depth.as_video_stream_profile().get_intrinsics())
        try:
            pose = depth.get_extrinsics_to(colour)
        except RuntimeError:  # nobody said: then it is one camera, or nothing can be aligned
            return own == self._lens
        same_place = np.allclose(pose.translation, 0.0) and np.allclose(np.reshape(pose.rotation, (3, 3)), np.eye(3))
        return bool(own == self._lens and same_place)

    def _compose(self, frame: Any, source: Any) -> None:
        source.frame_ready(source.allocate_composite_frame(self._pair))

    def take(self, frame: Any) -> None:
        """A frame of any stream."""
        stream = frame.get_profile().stream_type().name
        if stream in self._samples:
            data = frame.as_motion_frame().get_motion_data()
            self._samples[stream].append([frame.get_timestamp() / 1000.0, data.x, data.y, data.z])
            return
        if stream not in self._waiting:
            return
        self._waiting[stream].append(frame)
        other = self._waiting["depth" if stream == "color" else "color"]
        near = [f for f in other if abs(f.get_timestamp() - frame.get_timestamp()) <= 1000.0 * MAX_APART_S]
        if not near:
            return
        partner = min(near, key=lambda f: abs(f.get_timestamp() - frame.get_timestamp()))
        colour, depth = (frame, partner) if stream == "color" else (partner, frame)
        for name, last in (("color", colour), ("depth", depth)):
            while self._waiting[name] and self._waiting[name][0].get_timestamp() <= last.get_timestamp():
                self._waiting[name].popleft()
        self._pairs.append((colour, depth))

    def next(self, number: int, ended: bool) -> RawFrame | None:
        """The next RGB-D frame, if one is complete.

        Args:
            number: for its name.
            ended: nothing more comes.
        """
        if not self._pairs:
            return None
        time_s = self._pairs[0][0].get_timestamp() / 1000.0
        felt = self._samples["accel"]
        if self._holds and not ended and len(self._pairs) <= HELD and not (felt and felt[-1][0] > time_s):
            return None
        return self._join(*self._pairs.popleft(), number)

    def _join(self, colour: Any, depth: Any, number: int) -> RawFrame:
        for step in self._filters:
            depth = step.process(depth)
        if self._align is not None:
            self._pair = [depth, colour]
            self._composer.invoke(depth)
            frames = self._composed.wait_for_frame().as_frameset()
            depth = self._align.process(frames).get_depth_frame()
            self._pair = []
        rgb = np.array(np.asanyarray(colour.get_data()))
        if colour.get_profile().format().name == "bgr8":
            rgb = np.ascontiguousarray(rgb[..., ::-1])
        unit_m = np.float32(depth.as_depth_frame().get_units())
        depth_m = np.asanyarray(depth.get_data()).astype(np.float32) * unit_m
        time_s = colour.get_timestamp() / 1000.0
        samples = [self._felt(name, time_s) for name in ("accel", "gyro")]
        return RawFrame(f"frame_{number:06d}", time_s, rgb, depth_m, self._lens, imu=ImuSamples(*samples))

    def _felt(self, name: str, time_s: float) -> np.ndarray:
        """(k, 4) samples since the last frame; where frames are held, those of after this one stay."""
        rows, taken = self._samples[name], []
        while rows and not (self._holds and rows[0][0] > time_s):
            taken.append(rows.popleft())
        return np.array(taken) if taken else no_samples()


def _post_processing(sdk: Any) -> list[Any]:
    """The SDK's recommended order, without what changes the image's size."""
    return [
        sdk.disparity_transform(True),
        sdk.spatial_filter(),
        sdk.temporal_filter(),
        sdk.disparity_transform(False),
    ]
