"""The one interface of everything that gives RGB-D frames, and the errors by which a source ends early.

A source is iterated over. It yields `RawFrame`s as its device or file has them; `perception.sources.preparation` makes
of each what the estimator takes: rectified, depth aligned to colour, with gravity.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from perception.lens.lenses import Lens

IMU_COLUMNS = 4  # time, x, y, z


class SourceError(ValueError):
    """A source cannot be used, or not any further; the message says which and what would help."""


class MissingExtraError(SourceError):
    """A library that the source needs is not installed; the message says how to install it."""


class MissingTopicError(SourceError):
    """A recording lacks a stream that was asked for; the message lists what it holds."""


class MissingImuError(SourceError):
    """Gravity was to come from the IMU, and the source has none."""


class BrokenRecordingError(SourceError):
    """A recording is cut short or damaged; frames that came before it are good."""


class DeviceLostError(SourceError):
    """A live device went silent or was unplugged; frames that came before it are good."""


class UnalignedDepthError(SourceError):
    """Depth is that of another camera than colour's, and how the two stand to each other is not known."""


def no_samples() -> np.ndarray:
    """(0, 4) float64: no IMU samples."""
    return np.zeros((0, IMU_COLUMNS))


@dataclass(frozen=True)
class ImuSamples:
    """What an IMU measured since the last frame; the two sensors sample at rates of their own.

    Attributes:
        acceleration: (k, 4) float64: time in seconds, specific force x, y, z in m/s^2.
        rate: (k, 4) float64: time in seconds, angular velocity x, y, z in rad/s.
            Both in the camera's axes: x right, y down, z forward. Oldest first.
    """

    acceleration: np.ndarray = field(default_factory=no_samples)
    rate: np.ndarray = field(default_factory=no_samples)


@dataclass(frozen=True)
class RawFrame:
    """A frame as its source has it.

    Attributes:
        name: unique within the source; also names the frame's pictures.
        time_s: of the capture, seconds on the source's clock.
        rgb: uint8 (H, W, 3), not rectified.
        depth_m: float32 (H', W') metres along the optical axis, 0 = no reading; None when there is only colour.
        lens: of the colour camera.
        depth_lens: of the depth image when it is not aligned to colour; None when it is.
        depth_to_colour: (4, 4) from the depth camera's frame to the colour camera's; None when unknown.
        imu: samples since the last frame.
        gravity: (3,) that the source states for this frame (a side-car), camera axes; None when it states none.
        hints: what looks wrong about the files that the frame came from.
        files: colour and depth, for a frame that was read from files of its own.
    """

    name: str
    time_s: float
    rgb: np.ndarray
    depth_m: np.ndarray | None
    lens: Lens
    depth_lens: Lens | None = None
    depth_to_colour: np.ndarray | None = None
    imu: ImuSamples = field(default_factory=ImuSamples)
    gravity: np.ndarray | None = None
    hints: tuple[str, ...] = ()
    files: tuple[str, ...] = ()


class Source(Protocol):
    """What gives frames. Iterating begins at the first frame, or now for a device."""

    @property
    def name(self) -> str:
        """What it is, in words: a serial number, a file."""

    def __iter__(self) -> Iterator[RawFrame]:
        """Yield frames until there are no more.

        Raises:
            SourceError: it ends before its end; what was yielded before is good.
        """

    def __len__(self) -> int:
        """How many frames; 0 when that is not known before the end."""

    def close(self) -> None:
        """Give the device or file back; safe to call twice."""
