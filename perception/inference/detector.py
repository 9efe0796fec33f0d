"""The network as the estimator sees it: images of any size in, two grids out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perception.inference.backends import Backend, make_backend
from perception.inference.preprocess import letterbox


class NetworkDetector:
    """StairNetV2 with its shipped weights.

    Args:
        width: 1.0, 0.5 or 0.25.
        backend: one of `perception.inference.backends.BACKENDS`, or a back end of your own.
        threads: see `perception.inference.backends`.

    Raises:
        SpecError: no such back end (a ValueError).
        WeightsError: no weights of that width.
    """

    def __init__(self, width: float = 0.25, backend: str | Backend = "onnx", threads: int | None = None) -> None:
        self._backend = make_backend(backend, width, threads) if isinstance(backend, str) else backend

    def detect(self, rgb: Sequence[np.ndarray], depth_m: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Run on a batch.

        Args:
            rgb: B images uint8 (H, W, 3), sizes may differ.
            depth_m: B images float32 (H, W), metres, 0 = no reading, finite.

        Returns:
            cls (B, 32, 16) and loc (B, 32, 16, 8), cells of the letterboxed 512 x 512 image.
        """
        frames = [letterbox(image, depth) for image, depth in zip(rgb, depth_m, strict=True)]
        if not frames:
            return np.zeros((0, 32, 16), np.float32), np.zeros((0, 32, 16, 8), np.float32)
        if len(frames) == 1:
            return self._backend(frames[0][0][None], frames[0][1][None])
        return self._backend(np.stack([image for image, _ in frames]), np.stack([depth for _, depth in frames]))
