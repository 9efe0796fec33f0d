"""ROS messages as arrays: what image, camera_info and imu messages hold, whoever read them.

Works on anything with the messages' attributes: rosbags' classes, rclpy's, or stand-ins of a test.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from perception.lens.lenses import Lens, ros_lens
from perception.sources.source import SourceError

NANO = 1e-9
# encoding -> (type, channels, order that gives RGB)
ENCODINGS: dict[str, tuple[type, int, tuple[int, ...]]] = {
    "rgb8": (np.uint8, 3, (0, 1, 2)),
    "bgr8": (np.uint8, 3, (2, 1, 0)),
    "rgba8": (np.uint8, 4, (0, 1, 2)),
    "bgra8": (np.uint8, 4, (2, 1, 0)),
    "mono8": (np.uint8, 1, (0, 0, 0)),
    "8UC1": (np.uint8, 1, (0, 0, 0)),
    "8UC3": (np.uint8, 3, (2, 1, 0)),
}
DEPTH_ENCODINGS: dict[str, tuple[type, float]] = {
    "16UC1": (np.uint16, 0.001),  # REP 118: millimetres
    "mono16": (np.uint16, 0.001),
    "32FC1": (np.float32, 1.0),
}
COMPRESSED_DEPTH_HEADER = 12  # bytes before the PNG of compressed_depth_image_transport


def stamp_s(message: Any) -> float:
    """The header's time, seconds."""
    stamp = message.header.stamp
    seconds = stamp.sec if hasattr(stamp, "sec") else stamp.secs
    nanoseconds = getattr(stamp, "nanosec", None)
    if nanoseconds is None:
        nanoseconds = stamp.nsecs if hasattr(stamp, "nsecs") else stamp.nsec
    return float(seconds) + NANO * float(nanoseconds)


def colour_of(message: Any) -> np.ndarray:
    """uint8 (H, W, 3) RGB of an Image or CompressedImage.

    Raises:
        SourceError: an encoding that is no colour, or data that cannot be decoded.
    """
    if hasattr(message, "format"):
        image = _decoded(bytes(message.data), cv2.IMREAD_COLOR, message.format)
        return np.ascontiguousarray(image[..., ::-1])
    if message.encoding not in ENCODINGS:
        raise SourceError(f"colour has encoding {message.encoding!r}, must be one of {', '.join(ENCODINGS)}")
    kind, channels, order = ENCODINGS[message.encoding]
    image = _rows(message, kind, channels)
    return np.ascontiguousarray(image[..., list(order)])


def depth_of(message: Any) -> np.ndarray:
    """float32 (H, W) metres of an Image or CompressedImage ("compressedDepth" too), 0 = no reading.

    Raises:
        SourceError: an encoding that is no depth (colourised depth is none), or data that cannot be decoded.
    """
    if hasattr(message, "format"):
        data = bytes(message.data)
        if "compressedDepth" in message.format:
            data = data[COMPRESSED_DEPTH_HEADER:]
        image = _decoded(data, cv2.IMREAD_UNCHANGED, message.format)
        if image.ndim != 2 or image.dtype != np.uint16:
            raise SourceError(
                f"compressed depth is {image.dtype} of shape {image.shape}, must be 16-bit of one channel"
            )
        return image.astype(np.float32) * np.float32(0.001)
    if message.encoding not in DEPTH_ENCODINGS:
        raise SourceError(
            f"depth has encoding {message.encoding!r}, must be one of {', '.join(DEPTH_ENCODINGS)}; "
            "a coloured picture of depth cannot be measured"
        )
    kind, unit_m = DEPTH_ENCODINGS[message.encoding]
    depth = _rows(message, kind, 1)[..., 0].astype(np.float32) * np.float32(unit_m)
    return np.where(np.isfinite(depth) & (depth > 0.0), depth, np.float32(0.0))


def _rows(message: Any, kind: type, channels: int) -> np.ndarray:
    """(H, W, channels) of an Image, whose rows may be padded."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.frombuffer(bytes(message.data), np.uint8)
    item = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    used = width * channels * item.itemsize
    if height <= 0 or width <= 0 or step < used or data.size < step * height:
        raise SourceError(f"image of {width}x{height} {message.encoding} has {data.size} bytes in rows of {step}")
    rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :used])
    return rows.view(item).reshape(height, width, channels).astype(kind)


def _decoded(data: bytes, mode: int, form: str) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), mode) if data else None
    if image is None:
        raise SourceError(f"a compressed image ({form!r}) cannot be decoded")
    return np.asarray(image)


def lens_of(message: Any) -> Lens:
    """Lens of a CameraInfo.

    Raises:
        SpecError: numbers that do not fit, as of a camera that was never calibrated (a ValueError).
    """
    k = message.k if hasattr(message, "k") else message.K
    d = message.d if hasattr(message, "d") else message.D
    return ros_lens(
        message.width, message.height, [float(v) for v in k], message.distortion_model, [float(v) for v in d]
    )


def imu_of(message: Any) -> tuple[np.ndarray | None, np.ndarray | None]:
    """(4,) time and specific force, (4,) time and angular velocity of an Imu; None for what a driver marks as unknown.

    realsense-ros publishes accelerometer and gyro as Imu messages of their own, the other half zero.
    """
    time_s = stamp_s(message)
    force, rate = message.linear_acceleration, message.angular_velocity
    known_force = message.linear_acceleration_covariance[0] != -1.0 and any((force.x, force.y, force.z))
    known_rate = message.angular_velocity_covariance[0] != -1.0 and any((rate.x, rate.y, rate.z))
    return (
        np.array([time_s, force.x, force.y, force.z]) if known_force else None,
        np.array([time_s, rate.x, rate.y, rate.z]) if known_rate else None,
    )


def extrinsics_of(message: Any) -> tuple[np.ndarray, np.ndarray]:
    """(3, 3) rotation and (3,) translation of realsense-ros's Extrinsics, whose rotation lies column by column."""
    return np.array(message.rotation, np.float64).reshape(3, 3).T, np.array(message.translation, np.float64)
