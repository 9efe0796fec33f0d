"""One network for the cameras of many processes: a Ray actor that runs the frames which wait in one batch.

A network of its own in each process gives the same to the last bit and needs no messages; a server pays where one
machine of a cluster has a graphics card.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from perception.inference.backends import MAX_BATCH, Backend, OnnxBackend, TorchBackend
from perception.inference.preprocess import letterbox

CONCURRENT = 1000  # processes that may wait at a time
GPU_BATCH = 64  # frames that a graphics card runs at once


class FrameQueue:
    """Batches frames: while one batch is run, the next ones gather.

    Args:
        backend: that runs them.
        max_batch: frames at once.
    """

    def __init__(self, backend: Backend, max_batch: int = MAX_BATCH) -> None:
        self._backend, self._max_batch = backend, max_batch
        self._waiting: list[tuple[np.ndarray, np.ndarray, asyncio.Future[Any]]] = []
        self._running: asyncio.Task[None] | None = None
        self.batches: list[int] = []  # sizes of the latest

    async def run(self, rgb: np.ndarray, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The network's answer to one letterboxed frame.

        Args:
            rgb: uint8 (512, 512, 3).
            depth_m: float32 (512, 512), metres, 0 = no reading.

        Returns:
            cls (32, 16) and loc (32, 16, 8).
        """
        answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._waiting.append((rgb, depth_m, answer))
        if self._running is None or self._running.done():
            self._running = asyncio.ensure_future(self._drain())
        return await answer

    async def _drain(self) -> None:
        """Run what waits until nothing does."""
        loop = asyncio.get_running_loop()
        while self._waiting:
            batch, self._waiting = self._waiting[: self._max_batch], self._waiting[self._max_batch :]
            self.batches = [*self.batches[-99:], len(batch)]
            rgb, depth = np.stack([image for image, _, _ in batch]), np.stack([image for _, image, _ in batch])
            try:
                cls, loc = await loop.run_in_executor(None, self._backend, rgb, depth)
            except Exception as error:
                for _, _, answer in batch:
                    answer.set_exception(error)
                continue
            for index, (_, _, answer) in enumerate(batch):
                answer.set_result((cls[index], loc[index]))


class _Server:
    """The actor."""

    def __init__(self, width: float, cuda: bool) -> None:
        backend = TorchBackend(width, device="cuda") if cuda else OnnxBackend(width)
        self._queue = FrameQueue(backend, GPU_BATCH if cuda else MAX_BATCH)

    async def run(self, rgb: np.ndarray, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return await self._queue.run(rgb, depth_m)

    async def batches(self) -> list[int]:
        return self._queue.batches


@dataclass(frozen=True)
class ServedDetector:
    """`perception.estimator.Detector` that asks a server.

    Attributes:
        server: handle of the actor.
        width: of its network.
        device: that it runs on, "cpu" or "cuda".
    """

    server: Any
    width: float
    device: str

    def detect(self, rgb: Sequence[np.ndarray], depth_m: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Run on a batch; see `Detector`."""
        import ray

        frames = [letterbox(image, depth) for image, depth in zip(rgb, depth_m, strict=True)]
        answers = ray.get([self.server.run.remote(image, depth) for image, depth in frames])
        return np.stack([cls for cls, _ in answers]), np.stack([loc for _, loc in answers])

    def batches(self) -> list[int]:
        """Sizes of the latest batches."""
        import ray

        sizes: list[int] = ray.get(self.server.batches.remote())
        return sizes


def start_frame_server(width: float = 0.25) -> ServedDetector:
    """Start a server on the Ray cluster that this process is connected to; it ends when nobody holds it any more.

    On a node with a graphics card it runs torch there, elsewhere ONNX Runtime. Lost with its node, it begins again on
    another one.

    Args:
        width: of the network, 1.0, 0.5 or 0.25.
    """
    import ray

    cuda = ray.cluster_resources().get("GPU", 0) >= 1
    options = {"num_cpus": 0, "max_concurrency": CONCURRENT, "max_restarts": -1, "max_task_retries": -1}
    server = ray.remote(_Server).options(**options, num_gpus=int(cuda)).remote(width, cuda)
    return ServedDetector(server, width, "cuda" if cuda else "cpu")
