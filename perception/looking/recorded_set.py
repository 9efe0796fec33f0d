"""Frames of any source as a labelled set: images, depthes, labels and side-cars, as training reads them.

Labels are drafts: the network's own lines, to be checked by hand. Their side-car says so.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from perception.data.label_grid import format_labels, order_left_first
from perception.data.writer import DEPTHS, IMAGES, JPEG_QUALITY, LABELS, PNG_COMPRESSION
from perception.estimator import Detector
from perception.geometry.lines import find_lines
from perception.inference.preprocess import letterbox
from perception.sources.preparation import SourceFrame
from perception.sources.source import SourceError
from stair_env.common.constants import IMAGE_SIZE
from stair_env.common.files import atomic_path

DEPTH_UNIT_M = 0.001


class RecordedSet:
    """A folder in the training format that grows frame by frame; a frame with a label is complete.

    Args:
        folder: of one split; frames that are there already stay.
        detector: drafts the labels; None leaves them empty for a labelling tool, and writes no label file.
    """

    def __init__(self, folder: Path, detector: Detector | None = None) -> None:
        self._folder, self._detector = folder, detector
        for name in (IMAGES, DEPTHS, *((LABELS,) if detector is not None else ())):
            (folder / name).mkdir(parents=True, exist_ok=True)
        stems = [path.stem for path in (folder / IMAGES).glob("*.jpg")]
        self._next = 1 + max((int(stem) for stem in stems if stem.isdigit()), default=-1)

    def add(self, frame: SourceFrame) -> str:
        """Write one frame.

        Returns:
            Its name in the set.

        Raises:
            SourceError: it has no depth.
            OSError: it cannot be written.
        """
        if frame.depth_m is None:
            raise SourceError(f"{frame.name}: has no depth, which every frame of a set needs")
        stem = f"{self._next:06d}"
        self._next += 1
        rgb, depth = letterbox(frame.rgb, frame.depth_m)
        units = np.clip(np.rint(depth / DEPTH_UNIT_M), 0, 65535).astype(np.uint16)
        self._write(IMAGES, f"{stem}.jpg", _encoded(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]))
        self._write(DEPTHS, f"{stem}.png", _encoded(".png", units, [cv2.IMWRITE_PNG_COMPRESSION, PNG_COMPRESSION]))
        self._write(IMAGES, f"{stem}.json", json.dumps(self._side_car(frame), indent=2).encode())
        if self._detector is not None:
            cls, loc = self._detector.detect([rgb], [depth])
            lines = find_lines(cls[0], loc[0])[:, :4]
            kinds = np.zeros(len(lines), np.int64)  # the network has one class; convex until somebody looks
            self._write(LABELS, f"{stem}.txt", format_labels(kinds, order_left_first(lines)).encode())
        return stem

    def _side_car(self, frame: SourceFrame) -> dict[str, Any]:
        model = frame.intrinsics.letterboxed(IMAGE_SIZE)
        values: dict[str, Any] = {name: getattr(model, name) for name in ("fx", "fy", "cx", "cy")}
        if frame.gravity is not None:
            values["gravity"] = frame.gravity.tolist()
        labels = "drafts of the network, unchecked" if self._detector is not None else "none"
        return {
            **values,
            "gravity_source": frame.gravity_source,
            "depth_scale": DEPTH_UNIT_M,
            "time_s": frame.time_s,
            "source_frame": frame.name,
            "labels": labels,
            "hints": list(frame.hints),
        }

    def _write(self, folder: str, name: str, data: bytes) -> None:
        with atomic_path(self._folder / folder / name) as temporary:
            temporary.write_bytes(data)


def _encoded(kind: str, image: np.ndarray, options: list[int]) -> bytes:
    ok, data = cv2.imencode(kind, np.ascontiguousarray(image), options)
    if not ok:
        raise OSError(f"an image of shape {image.shape} could not be encoded as {kind}")
    return bytes(data.tobytes())
