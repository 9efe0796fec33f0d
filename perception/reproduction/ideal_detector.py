"""A detector that cannot be better: it answers with the true lines, jittered if asked.

What an estimator makes of it is the floor of everything behind the network.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perception.data.label_grid import encode_grid
from perception.inference.preprocess import letterbox_lines
from stair_env.sensors.camera.labels import LineLabel


class IdealDetector:
    """Stands in for StairNetV2 (`perception.estimator.Detector`).

    Args:
        jitter_px: standard deviation of each predicted end point across the line, pixels of the 512 x 512 image.
        miss_rate: share of line cells that are not scored.
        rng: draws jitter and misses; needed when there are any.
    """

    def __init__(self, jitter_px: float = 0.0, miss_rate: float = 0.0, rng: np.random.Generator | None = None) -> None:
        if (jitter_px > 0.0 or miss_rate > 0.0) and rng is None:
            raise ValueError("jitter_px or miss_rate above 0 needs rng")
        self._jitter_px, self._miss_rate, self._rng = jitter_px, miss_rate, rng
        self._next: list[np.ndarray] = []

    def show(self, labels: Sequence[LineLabel], width: int, height: int) -> None:
        """Say what the next image to be detected holds.

        Args:
            labels: its stair lines, pixels of the width x height image.
            width, height: of that image.
        """
        lines = np.array([(label.x1, label.y1, label.x2, label.y2) for label in labels]).reshape(-1, 4)
        self._next.append(letterbox_lines(lines, width, height))

    def detect(self, rgb: Sequence[np.ndarray], depth_m: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Grids of the images announced by `show`, in that order.

        Raises:
            ValueError: more images than were announced.
        """
        if len(rgb) > len(self._next):
            raise ValueError(f"{len(rgb)} images, but show() announced {len(self._next)}")
        shown, self._next = self._next[: len(rgb)], self._next[len(rgb) :]
        grids = [encode_grid(lines) for lines in shown]
        cls, loc = np.stack([grid.cls for grid in grids]), np.stack([grid.loc for grid in grids]).copy()
        if self._rng is not None:
            cls = np.where(self._rng.random(cls.shape) < self._miss_rate, 0.0, cls)
            noise = self._rng.normal(0.0, self._jitter_px / 16.0, (*loc.shape[:3], 2))
            # Both predictions of a cell come from the same features and err together.
            loc[..., 1::2] += np.concatenate([noise, noise], axis=-1)
        return cls, np.clip(loc, 0.0, 1.0)
