"""A rendered staircase that a camera looks at while it moves, and an IMU's readings: what sources are tested with."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from perception.lens.lenses import Lens
from perception.sources.source import ImuSamples, RawFrame
from stair_env.common.transforms import look_along
from stair_env.intrinsics import Intrinsics
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.renderers.factory import make_renderer
from stair_env.stairs import StairSpec

CAMERA = Intrinsics(320, 240, 307.5, 307.5, 160.0, 120.0)
FRAME_S = 1.0 / 30.0


@functools.cache
def drawn(count: int = 4) -> tuple[RawFrame, ...]:
    """Frames of a camera that walks towards the stairs, level IMU at 200 and 250 Hz."""
    scene = Scene(SceneSpec(StairSpec(riser_height=0.15, tread_depth=0.30)))
    renderer = make_renderer("raycast", scene)
    frames = []
    for index in range(count):
        pose = look_along(np.array([-0.9 + 0.01 * index, 0.0, 0.9]), 0.1, 0.5, 0.03)
        image = renderer.render(CAMERA, pose)
        time_s = 10.0 + index * FRAME_S
        gravity = 9.8 * pose[2, :3]
        force = [[t, *gravity] for t in np.arange(time_s - FRAME_S, time_s, 1 / 250)]
        rate = [[t, 0.0, 1e-6, 0.0] for t in np.arange(time_s - FRAME_S, time_s, 1 / 200)]
        depth = np.rint(1000 * image.depth_m).astype(np.float32) / np.float32(1000)
        imu = ImuSamples(np.array(force), np.array(rate))
        frames.append(RawFrame(f"frame_{index:06d}", time_s, image.rgb, depth, Lens(CAMERA), imu=imu))
    renderer.close()
    return tuple(frames)


class ListSource:
    """A source of given frames, which may end early."""

    def __init__(self, frames: tuple[RawFrame, ...], error: Exception | None = None) -> None:
        self._frames, self._error = frames, error

    name = "list"

    def __len__(self) -> int:
        return len(self._frames)

    def __iter__(self):  # type: ignore[no-untyped-def]
        yield from self._frames
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """Nothing to close."""


@pytest.fixture
def frames() -> tuple[RawFrame, ...]:
    return drawn()
