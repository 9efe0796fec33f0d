"""Frames of many processes through one network: batched, and each gets its own answer."""

from __future__ import annotations

import asyncio
import threading

import numpy as np
import pytest

from perception.inference.frame_server import FrameQueue
from stair_env.common.constants import GRID_COLUMNS, GRID_ROWS


class Counting:
    """Answers each frame with its first pixel, and waits until it may."""

    def __init__(self) -> None:
        self.go = threading.Event()

    def __call__(self, rgb: np.ndarray, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.go.wait(10.0)
        if (rgb == 255).any():
            raise ValueError("too bright")
        values = rgb[:, 0, 0, 0].astype(np.float32) + depth_m[:, 0, 0]
        return np.broadcast_to(values[:, None, None], (len(rgb), GRID_ROWS, GRID_COLUMNS)), np.zeros((len(rgb), 1))


def frame(value: int) -> tuple[np.ndarray, np.ndarray]:
    return np.full((4, 4, 3), value, np.uint8), np.full((4, 4), 0.5, np.float32)


def test_frames_that_wait_make_a_batch_and_get_their_own_answers() -> None:
    backend = Counting()
    queue = FrameQueue(backend, max_batch=4)

    async def ask() -> list:
        asked = [asyncio.ensure_future(queue.run(*frame(value))) for value in range(10)]
        await asyncio.sleep(0.05)
        backend.go.set()
        return await asyncio.gather(*asked)

    answers = asyncio.run(ask())
    assert [float(cls[0, 0]) for cls, _ in answers] == [value + 0.5 for value in range(10)]
    assert sum(queue.batches) == 10 and max(queue.batches) == 4 and len(queue.batches) <= 4


def test_a_failure_is_told_to_those_whose_frames_failed() -> None:
    backend = Counting()
    backend.go.set()
    queue = FrameQueue(backend, max_batch=1)

    async def ask() -> list:
        return await asyncio.gather(*(queue.run(*frame(value)) for value in (1, 255, 2)), return_exceptions=True)

    first, second, third = asyncio.run(ask())
    assert isinstance(second, ValueError) and float(first[0][0, 0]) == 1.5 and float(third[0][0, 0]) == 2.5


@pytest.mark.slow
def test_flights_with_a_shared_network_are_those_with_ones_own() -> None:
    """On the CPU both run ONNX Runtime, and the measured staircases agree to the last bit."""
    ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'stair-env[ray]', or make test-ray")
    from perception.inference.backends import OnnxBackend
    from perception.inference.frame_server import start_frame_server
    from stair_env.common.tasks import Engine
    from stair_env.common.tasks.ray_pool import ray_session

    rng = np.random.default_rng(0)
    rgb = [rng.integers(0, 255, (480, 640, 3), np.uint8) for _ in range(3)]
    depth = [rng.uniform(0.3, 4.0, (480, 640)).astype(np.float32) for _ in range(3)]
    from perception.inference.detector import NetworkDetector

    own = NetworkDetector(backend=OnnxBackend(0.25, threads=1))
    with ray_session(Engine("ray", workers=1)):
        served = start_frame_server()
        answers = served.detect(rgb, depth)
        assert sum(served.batches()) == 3 and served.device == ("cuda" if ray.cluster_resources().get("GPU") else "cpu")
    for index in range(3):
        cls, loc = own.detect(rgb[index : index + 1], depth[index : index + 1])
        if served.device == "cpu":
            assert np.array_equal(cls[0], answers[0][index]) and np.array_equal(loc[0], answers[1][index])
        else:
            np.testing.assert_allclose(cls[0], answers[0][index], atol=1e-3)
