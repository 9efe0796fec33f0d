"""Writes rendered data sets in the paper's format: images (jpg), depthes (png), labels (txt), one folder a split.

Beside each image stands a JSON side-car with intrinsics, gravity, light and the true geometry. Depth is 16-bit in
millimetres. A frame's generator is seeded with (seed, split, index), so that splits are disjoint, any number of
processes or machines gives the same set, and an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from perception.data.label_grid import format_labels
from perception.data.stair_dataset import read_side_car
from perception.data.synthetic import DEPTH_UNIT_M, FrameConfig, LabelledFrame, draw_frame
from stair_env.common.field_kinds import naming_fields
from stair_env.common.files import atomic_path
from stair_env.common.tasks import LOCAL, Engine, run_tasks

SPLITS = ("train", "val", "test")
IMAGES, DEPTHS, LABELS = "images", "depthes", "labels"  # folder names of the public set
JPEG_QUALITY = 95
NOTE = "dataset.json"  # in the set's folder: seed, settings, counts
PNG_COMPRESSION = 1  # 1.3 times the size of the default at a fifth of the time


@dataclass(frozen=True)
class DatasetPlan:
    """Which frames to write.

    Args:
        root: folder that gets one folder per split.
        frames: split -> number of frames, each an RGB and a depth image. The default is the paper's 4776 and 1216
            images, and a test set as large as the validation set.
        seed: of the whole set.
        config: what kind of frames.

    Raises:
        ValueError: an unknown split or a negative number.
    """

    root: Path
    frames: dict[str, int] = field(default_factory=lambda: {"train": 2388, "val": 608, "test": 608})
    seed: int = 0
    config: FrameConfig = field(default_factory=FrameConfig)

    @naming_fields
    def __post_init__(self) -> None:
        for split, count in self.frames.items():
            if split not in SPLITS:
                raise ValueError(f"split={split!r} must be one of {', '.join(SPLITS)}")
            if count < 0:
                raise ValueError(f"frames of {split}={count!r} must not be negative")

    def rng(self, split: str, index: int) -> np.random.Generator:
        """The generator of one frame."""
        return np.random.default_rng([self.seed, SPLITS.index(split), index])

    def describe(self) -> dict[str, Any]:
        """JSON form of everything but the folder and the numbers of frames."""
        config = dataclasses.asdict(self.config)
        return {"seed": self.seed, "config": json.loads(json.dumps(config))}


def missing_frames(plan: DatasetPlan) -> list[tuple[str, int]]:
    """(split, index) of the frames that are not written yet."""
    missing: list[tuple[str, int]] = []
    for split, count in plan.frames.items():
        done = {path.name.split("_")[0] for path in (plan.root / split / LABELS).glob("*.txt")}
        missing.extend((split, index) for index in range(count) if f"{index:06d}" not in done)
    return missing


def write_missing(plan: DatasetPlan, engine: Engine = LOCAL) -> Iterator[tuple[str, str]]:
    """Write the frames that are not there yet.

    Args:
        plan: which.
        engine: where they are drawn; this process writes them.

    Yields:
        (split, lighting) of each written frame, in any order.

    Raises:
        stair_env.common.tasks.EngineError: Ray is not to be had, or a frame loses its workers again and again.
    """
    _claim(plan)
    for split in plan.frames:
        for folder in (IMAGES, DEPTHS, LABELS, *stereo_folders(plan.config.stereo_variants)):
            (plan.root / split / folder).mkdir(parents=True, exist_ok=True)
    for (split, _), drawn in run_tasks(_draw, missing_frames(plan), engine, shared=plan):
        _write_files(plan.root / split, drawn.files)
        yield split, drawn.lighting


def _claim(plan: DatasetPlan) -> None:
    """Note in the folder what it holds, or check that the note says the same.

    Raises:
        ValueError: the folder holds a set of another seed or other frames.
    """
    note = plan.root / NOTE
    if note.is_file():
        if read_side_car(note).get("made_by") != plan.describe():
            raise ValueError(f"{note}: the folder holds another set; choose another --output or the same settings")
        return
    plan.root.mkdir(parents=True, exist_ok=True)
    _write(note, json.dumps({"made_by": plan.describe()}, indent=2).encode())


def complete(plan: DatasetPlan) -> dict[str, Any]:
    """Count what is there and write it into the folder's note.

    Returns:
        {"images", "day", "night", "splits": {name: {...}}}: colour and depth images both counted, as the paper does.
    """
    splits = {}
    for split in plan.frames:
        names = [path.stem for path in (plan.root / split / LABELS).glob("*.txt") if not path.name.startswith(".")]
        by_light = {light: 2 * sum(name.endswith(f"_{light}") for name in names) for light in ("day", "night")}
        splits[split] = {"images": 2 * len(names), **by_light}
    total = {key: sum(counts[key] for counts in splits.values()) for key in ("images", "day", "night")}
    summary = {**total, "splits": splits}
    _write(plan.root / NOTE, json.dumps({"made_by": plan.describe(), **summary}, indent=2).encode())
    return summary


class _DrawnFrame(NamedTuple):
    """A frame's light, and its files by the path within the split's folder."""

    lighting: str
    files: dict[str, bytes]


def _draw(job: tuple[str, int], plan: DatasetPlan) -> _DrawnFrame:
    split, index = job
    frame = draw_frame(plan.rng(split, index), plan.config, threads=1)
    return _DrawnFrame(frame.lighting, encode_frame(f"{index:06d}_{frame.lighting}", frame))


def write_frame(folder: Path, stem: str, frame: LabelledFrame) -> None:
    """Write one frame into a split's folder."""
    _write_files(folder, encode_frame(stem, frame))


def encode_frame(stem: str, frame: LabelledFrame) -> dict[str, bytes]:
    """One frame as files: path within the split's folder -> content.

    The label comes last: written in this order, a frame with a label is complete.
    """
    bgr = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR)
    files = {f"{IMAGES}/{stem}.jpg": _encoded(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])}
    for name, depth_m in zip((DEPTHS, *stereo_folders(len(frame.stereo_m))), (frame.depth_m, *frame.stereo_m)):
        millimetres = np.clip(np.rint(depth_m / DEPTH_UNIT_M), 0, 65535).astype(np.uint16)
        files[f"{name}/{stem}.png"] = _encoded(".png", millimetres, [cv2.IMWRITE_PNG_COMPRESSION, PNG_COMPRESSION])
    files[f"{IMAGES}/{stem}.json"] = json.dumps(frame.side_car()).encode()
    files[f"{LABELS}/{stem}.txt"] = format_labels(frame.kinds, frame.lines).encode()
    return files


def _write_files(folder: Path, files: dict[str, bytes]) -> None:
    for name, content in files.items():
        _write(folder / name, content)


def stereo_folders(variants: int) -> tuple[str, ...]:
    """Names of the folders that hold depth matched from infrared pairs, beside `depthes`."""
    return tuple(f"{DEPTHS}_stereo{index}" for index in range(1, variants + 1))


def _encoded(kind: str, image: np.ndarray, options: list[int]) -> bytes:
    ok, data = cv2.imencode(kind, image, options)
    if not ok:
        raise OSError(f"an image of shape {image.shape} could not be encoded as {kind}")
    return bytes(data.tobytes())


def _write(path: Path, data: bytes) -> None:
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
