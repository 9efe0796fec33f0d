"""How a detector does where depth lies: accuracy, recall and IOU a corruption, and which modality it then listens to.

The corruptions are those by which a detector that knew one renderer only was found out; strengths are fixed, so that
figures can be compared between weights. What detectors are trained with is drawn at random and wider
(`perception.data.depth_corruption`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from perception.data.label_grid import encode_grid
from perception.data.stair_dataset import Sample, StairDataset
from perception.inference.backends import Backend
from perception.learning.metrics import DetectionCounts, count_cells

if TYPE_CHECKING:
    from perception.network import StairNetV2

Corruption = Callable[[StairDataset, int, np.ndarray], np.ndarray]  # frames, index, depth -> depth
CONSTANT_M = 2.0


def _matched(frames: StairDataset, index: int, depth_m: np.ndarray) -> np.ndarray:
    return frames.depth(index, frames.matched_folders[0])


def _blurred(frames: StairDataset, index: int, depth_m: np.ndarray, sigma_px: float) -> np.ndarray:
    """Inverse depth averaged over what has a reading."""
    valid = (depth_m > 0.0).astype(np.float32)
    inverse = valid / np.maximum(depth_m, np.float32(0.05))
    weight = np.asarray(cv2.GaussianBlur(valid, (0, 0), sigma_px))
    mean = np.asarray(cv2.GaussianBlur(inverse, (0, 0), sigma_px)) / np.maximum(weight, 1e-6)
    return np.where(depth_m > 0.0, 1.0 / np.maximum(mean, 1e-3), 0.0).astype(np.float32)


def _single_holes(frames: StairDataset, index: int, depth_m: np.ndarray, share: float) -> np.ndarray:
    kept = np.random.default_rng(index).random(depth_m.shape) >= share
    return np.where(kept, depth_m, np.float32(0.0))


def _constant(frames: StairDataset, index: int, depth_m: np.ndarray) -> np.ndarray:
    return np.full_like(depth_m, CONSTANT_M)


def _of_another_frame(frames: StairDataset, index: int, depth_m: np.ndarray) -> np.ndarray:
    return frames.depth((index + len(frames) // 2) % len(frames))


def _none(frames: StairDataset, index: int, depth_m: np.ndarray) -> np.ndarray:
    return np.zeros_like(depth_m)


CORRUPTIONS: dict[str, Corruption] = {
    "as drawn": lambda frames, index, depth_m: depth_m,
    "matched": _matched,
    "blurred 4 px": partial(_blurred, sigma_px=4.0),
    "blurred 8 px": partial(_blurred, sigma_px=8.0),
    "blurred 16 px": partial(_blurred, sigma_px=16.0),
    "single holes 5 %": partial(_single_holes, share=0.05),
    "single holes 20 %": partial(_single_holes, share=0.2),
    "constant": _constant,
    "another frame's": _of_another_frame,
    "none": _none,
}


def score_corrupted(
    backend: Backend,
    frames: StairDataset,
    width: float,
    progress: Callable[[Iterable[str]], Iterable[str]] = iter,
) -> list[dict[str, Any]]:
    """One row a corruption and light.

    Args:
        backend: the detector.
        frames: the labelled set; "matched" is left out where it has no matched depth.
        width: of the detector, for the rows.
        progress: wraps the iteration over corruptions, to show a bar.

    Returns:
        Rows {"model", "width", "split", "lighting", "accuracy", "recall", "iou", "frames"}, per cent.
    """
    rows = []
    for name in progress(names_for(frames)):
        tallies: dict[str, DetectionCounts] = {}
        for index in range(len(frames)):
            sample = frames[index]
            depth = CORRUPTIONS[name](frames, index, sample.depth_m)
            cls, loc = backend(sample.rgb[None], depth[None])
            grid = encode_grid(sample.lines)
            counts = count_cells(cls, loc, grid.cls[None], grid.loc[None])
            for split in ("all", sample.lighting):
                tallies[split] = tallies.get(split, DetectionCounts()) + counts
        for split, total in tallies.items():
            row = {"model": "StairNetV2", "width": width, "split": name, "lighting": split}
            row |= {key: round(getattr(total, key), 2) for key in ("accuracy", "recall", "iou")}
            rows.append(row | {"frames": total.frames})
    return rows


def names_for(frames: StairDataset) -> list[str]:
    """The corruptions that a set allows."""
    return [name for name in CORRUPTIONS if name != "matched" or frames.matched_folders]


def colour_weights(
    network: StairNetV2, frames: StairDataset, indices: Sequence[int]
) -> dict[str, dict[str, list[float]]]:
    """How much the selective module listens to colour, by corruption and light.

    Args:
        network: in evaluation mode.
        frames: the labelled set.
        indices: of the frames to look at.

    Returns:
        {corruption: {"day": [...], "night": [...]}}: for each frame the mean over channels of colour's weight; depth's
        is the rest to 1.
    """
    import torch

    from perception.inference.preprocess import colour_input, depth_input

    seen: list[float] = []

    def keep(module: torch.nn.Module, inputs: Any, output: torch.Tensor) -> None:
        pair = output.view(output.shape[0], 2, -1)
        seen.extend(torch.softmax(pair, dim=1)[:, 0].mean(1).tolist())

    found: dict[str, dict[str, list[float]]] = {}
    handle = network.selective.select.register_forward_hook(keep)
    try:
        with torch.inference_mode():
            for name in names_for(frames):
                for index in indices:
                    sample: Sample = frames[index]
                    depth = CORRUPTIONS[name](frames, index, sample.depth_m)
                    inputs = colour_input(sample.rgb[None]), depth_input(depth[None])
                    network(*map(torch.from_numpy, inputs))
                    found.setdefault(name, {}).setdefault(sample.lighting, []).append(seen[-1])
    finally:
        handle.remove()
    return found


def mean_weights(found: dict[float, dict[str, dict[str, list[float]]]]) -> list[dict[str, Any]]:
    """Rows {"width", "split", "lighting", "colour_weight"} of what `colour_weights` found at each width."""
    return [
        {"width": width, "split": name, "lighting": light, "colour_weight": round(float(np.mean(values)), 3)}
        for width, by_name in found.items()
        for name, by_light in by_name.items()
        for light, values in by_light.items()
    ]


def draw_colour_weights(found: dict[float, dict[str, dict[str, list[float]]]]) -> Any:
    """A figure of `colour_weights` a width, each corruption a row, day and night beside one another.

    Args:
        found: width -> what `colour_weights` returned.

    Returns:
        matplotlib's figure.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.2 * len(found) + 1.4, 4.2), layout="constrained")
    axes = figure.subplots(1, len(found), sharey=True, squeeze=False)[0]
    for axis, (width, by_name) in zip(axes, found.items()):
        names = list(by_name)
        for offset, (light, colour) in enumerate((("day", "#e69f00"), ("night", "#0072b2"))):
            places = np.arange(len(names)) + 0.36 * (offset - 0.5)
            values = [by_name[name].get(light, [np.nan]) for name in names]
            means = [float(np.mean(value)) for value in values]
            spread = [float(np.std(value)) for value in values]
            axis.barh(places, means, 0.34, xerr=spread, color=colour, label=light, error_kw={"lw": 0.8})
        axis.set_yticks(np.arange(len(names)), names)
        axis.invert_yaxis()
        axis.set_xlim(0.0, 1.0)
        axis.axvline(0.5, color="0.6", lw=0.8)
        axis.set_title(f"{width:g}x", fontsize=10)
        axis.set_xlabel("weight of colour")
    axes[0].legend(fontsize=8, loc="lower right")
    return figure
