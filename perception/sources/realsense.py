"""A RealSense through its SDK: live, or from a recording that the SDK made (`stair-env[realsense]`).

Live devices, recordings and `rs.software_device` go the same way: every stream of a device is opened by itself, so that
accelerometer and gyro come at their full rates; `frame_joiner` joins colour and depth of one time.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from perception.sources.frame_joiner import FrameJoiner
from perception.sources.source import (
    BrokenRecordingError,
    DeviceLostError,
    MissingExtraError,
    MissingImuError,
    MissingTopicError,
    RawFrame,
    SourceError,
)
from stair_env.common.validation import check_range

COLOUR_FORMATS = ("rgb8", "bgr8")
QUEUE_SIZE = 16  # frames between the SDK's threads and ours; a recording waits, a device drops the oldest
TICK_S = 0.1


@dataclass(frozen=True)
class RealSenseOptions:
    """How a device is read.

    Args:
        width, height, rate_hz: of colour and depth; a recording has its own.
        filters: the SDK's post-processing of depth (disparity, spatial, temporal).
        need_imu: refuse a device without IMU.
        timeout_s: without a frame, after which a device is given up.

    Raises:
        SpecError: the timeout or a size is out of range (a ValueError).
    """

    width: int = 640
    height: int = 480
    rate_hz: int = 30
    filters: bool = False
    need_imu: bool = False
    timeout_s: float = 5.0

    def __post_init__(self) -> None:
        check_range("width", self.width, 1, 8192)
        check_range("height", self.height, 1, 8192)
        check_range("rate_hz", self.rate_hz, 1, 300)
        check_range("timeout_s", self.timeout_s, 0.1, 600.0)


def load_sdk() -> Any:
    """The module pyrealsense2.

    Raises:
        MissingExtraError: it, or the system library that it needs, is not installed.
    """
    try:
        import pyrealsense2
    except ImportError as error:
        needs = " and Debian's libusb-1.0-0 (apt-get install libusb-1.0-0)" if "libusb" in str(error) else ""
        raise MissingExtraError(
            f"a RealSense needs pyrealsense2{needs} ({error}): pip install 'stair-env[realsense]'; "
            "its wheel also needs Debian's libusb-1.0-0"
        ) from None
    return pyrealsense2


def open_device(serial: str | None = None, options: RealSenseOptions = RealSenseOptions()) -> RealSense:
    """A device on this machine.

    Args:
        serial: its number; None takes the first.
        options: how it is read.

    Raises:
        MissingExtraError: no SDK.
        SourceError: no such device.
    """
    sdk = load_sdk()
    devices = {d.get_info(sdk.camera_info.serial_number): d for d in sdk.context().query_devices()}
    if serial is None and devices:
        serial = next(iter(devices))
    if serial not in devices:
        there = ", ".join(devices) or "none; is it plugged in, and may this user read USB devices?"
        asked = "no RealSense" if serial is None else f"no RealSense of serial number {serial}"
        raise SourceError(f"{asked} found; there are: {there}")
    return RealSense(devices[serial], f"RealSense {serial}", options)


def open_recording(path: Path, options: RealSenseOptions = RealSenseOptions()) -> RealSense:
    """A recording that the SDK made.

    Raises:
        MissingExtraError: no SDK.
        BrokenRecordingError: the file is cut short, or no recording of the SDK's.
        OSError: there is no such file.
    """
    sdk = load_sdk()
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        context = sdk.context()
        playback = context.load_device(str(path))
        playback.set_real_time(False)
    except RuntimeError as error:
        raise BrokenRecordingError(f"{path}: the SDK cannot open it: {' '.join(str(error).split())}") from None
    return RealSense(playback, str(path), options, keep=context)


class RealSense:
    """Frames of a device of the SDK's.

    Args:
        device: an `rs.device`.
        name: what it is called.
        options: how it is read.
        keep: whatever must live as long as the device does.

    Raises:
        MissingExtraError: no SDK.
        MissingTopicError, MissingImuError: it lacks a stream.
    """

    def __init__(
        self, device: Any, name: str, options: RealSenseOptions = RealSenseOptions(), keep: Any = None
    ) -> None:
        self._sdk, self._device, self._name, self._options, self._keep = load_sdk(), device, name, options, keep
        self._playback = device.as_playback() if device.is_playback() else None
        self._sensors: list[Any] = []
        self._profiles = self._choose()
        for needed in ("color", "depth"):
            if needed not in self._profiles:
                raise MissingTopicError(f"{name}: has no {needed} stream; it has {', '.join(self._profiles) or 'none'}")
        if options.need_imu and "accel" not in self._profiles:
            raise MissingImuError(f"{name}: has no accelerometer (a D435 without i has none)")

    @property
    def name(self) -> str:
        """The serial number or the file."""
        return self._name

    def __len__(self) -> int:
        """Not known: 0."""
        return 0

    # ------------------------------------------------------------------ streams

    def _choose(self) -> dict[str, tuple[Any, Any]]:
        """Stream name -> (sensor, profile)."""
        chosen: dict[str, tuple[Any, Any]] = {}
        for sensor in self._device.query_sensors():
            offered: dict[str, list[Any]] = {}
            for profile in sensor.get_stream_profiles():
                offered.setdefault(profile.stream_type().name, []).append(profile)
            for stream, profiles in offered.items():
                best = self._best(stream, profiles)
                if best is not None and stream not in chosen:
                    chosen[stream] = (sensor, best)
        return chosen

    def _best(self, stream: str, profiles: list[Any]) -> Any:
        formats = {"color": COLOUR_FORMATS, "depth": ("z16",), "accel": ("motion_xyz32f",), "gyro": ("motion_xyz32f",)}
        if stream not in formats:
            return None
        fitting = [p for p in profiles if p.format().name in formats[stream]]
        if stream in ("accel", "gyro"):
            return max(fitting, key=lambda p: p.fps(), default=None)
        want = self._options
        exact = [p for p in fitting if _size(p) == (want.width, want.height) and p.fps() == want.rate_hz]
        exact.sort(key=lambda p: formats[stream].index(p.format().name))
        # A recording or a device of one mode has what it has.
        return exact[0] if exact else (fitting[0] if len({(_size(p), p.fps()) for p in fitting}) == 1 else None)

    def _start(self, mailbox: _Mailbox) -> None:
        by_sensor: dict[int, tuple[Any, list[Any]]] = {}
        for sensor, profile in self._profiles.values():
            name = sensor.get_info(self._sdk.camera_info.name)
            by_sensor.setdefault(hash(name), (sensor, []))[1].append(profile)
        if self._playback is not None:
            stopped = self._sdk.playback_status.stopped
            self._playback.set_status_changed_callback(lambda status: mailbox.end() if status == stopped else None)
            self._playback.pause()  # or what comes before the last sensor has started is lost
        for sensor, profiles in by_sensor.values():
            try:
                sensor.open(profiles)
                self._sensors.append(sensor)
                sensor.start(mailbox.put)
            except RuntimeError as error:
                self.close()
                raise SourceError(f"{self._name}: cannot be started: {' '.join(str(error).split())}") from None
        if self._playback is not None:
            self._playback.resume()

    def close(self) -> None:
        """Stop all streams; safe to call twice."""
        sensors, self._sensors = self._sensors, []
        for sensor in sensors:
            for stop in (sensor.stop, sensor.close):
                with contextlib.suppress(RuntimeError):  # it is gone already
                    stop()

    # ------------------------------------------------------------------ frames

    def __iter__(self) -> Iterator[RawFrame]:
        """Frames until a recording ends, or the device is closed.

        Raises:
            DeviceLostError: a device went silent.
            BrokenRecordingError: a recording holds no frame, or one that cannot be read.
        """
        mailbox = _Mailbox(waits=self._playback is not None)
        joiner = FrameJoiner(self._sdk, self._profiles, self._options.filters, holds=self._playback is not None)
        given = 0
        self._start(mailbox)
        try:
            ended = False
            while not ended:
                frame = mailbox.get(self._options.timeout_s)
                if frame is None:
                    ended = True
                else:
                    joiner.take(frame)
                while (raw := joiner.next(given, ended)) is not None:
                    given += 1
                    yield raw
            if self._playback is None and self._sensors:
                raise DeviceLostError(
                    f"{self._name}: no frame for {self._options.timeout_s:g} s, after {given} frames; was it unplugged?"
                )
            if self._playback is not None and given == 0:
                raise BrokenRecordingError(f"{self._name}: holds no frame with colour and depth of one time")
        except RuntimeError as error:  # the SDK's, on a damaged file or a lost device
            kind = DeviceLostError if self._playback is None else BrokenRecordingError
            raise kind(f"{self._name}: after {given} frames: {' '.join(str(error).split())}") from None
        finally:
            mailbox.shut()
            self.close()


def _size(profile: Any) -> tuple[int, int]:
    video = profile.as_video_stream_profile()
    return video.width(), video.height()


class _Mailbox:
    """Frames on their way from the SDK's threads to ours.

    Args:
        waits: a full box makes the SDK wait (recordings); else the oldest frame is dropped (devices).
    """

    def __init__(self, waits: bool) -> None:
        self._box: queue.Queue[Any] = queue.Queue(QUEUE_SIZE)
        self._waits, self._shut, self._ended = waits, threading.Event(), threading.Event()

    def put(self, frame: Any) -> None:
        """Called by the SDK."""
        frame.keep()
        while not self._shut.is_set():
            try:
                self._box.put(frame, timeout=TICK_S if self._waits else 0.0)
                return
            except queue.Full:
                if not self._waits:
                    with contextlib.suppress(queue.Empty):
                        self._box.get_nowait()

    def end(self) -> None:
        """Nothing more will come."""
        self._ended.set()

    def shut(self) -> None:
        """Nobody reads any more: waiting threads go on."""
        self._shut.set()

    def get(self, timeout_s: float) -> Any | None:
        """The next frame; None at the end, or when none came for so long."""
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                return self._box.get(timeout=TICK_S)
            except queue.Empty:
                if self._ended.is_set() or time.monotonic() > deadline:
                    return None
