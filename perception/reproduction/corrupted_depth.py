"""How a detector does where depth lies: accuracy, recall and IOU a corruption, and which modality it then listens to.

One row more has no colour, where depth is all there is.

The corruptions are those by which a detector that knew one renderer only was found out; strengths are fixed, so that
figures can be compared between weights. What detectors are trained with is drawn at random and wider
(`perception.data.depth_corruption`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
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
AS_DRAWN, NO_COLOUR = "as drawn", "no colour"


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
    AS_DRAWN: lambda frames, index, depth_m: depth_m,
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


def names_for(frames: StairDataset) -> list[str]:
    """The corruptions that a set allows, and `NO_COLOUR`."""
    return [*(name for name in CORRUPTIONS if name != "matched" or frames.matched_folders), NO_COLOUR]


def corrupted(frames: StairDataset, index: int, name: str) -> Sample:
    """A frame with its depth corrupted in the way of a name, or with a black image for `NO_COLOUR`."""
    sample = frames[index]
    if name == NO_COLOUR:
        return replace(sample, rgb=np.zeros_like(sample.rgb))
    return replace(sample, depth_m=CORRUPTIONS[name](frames, index, sample.depth_m))


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
            sample = corrupted(frames, index, name)
            cls, loc = backend(sample.rgb[None], sample.depth_m[None])
            grid = encode_grid(sample.lines)
            counts = count_cells(cls, loc, grid.cls[None], grid.loc[None])
            for split in ("all", sample.lighting):
                tallies[split] = tallies.get(split, DetectionCounts()) + counts
        for split, total in tallies.items():
            row = {"model": "StairNetV2", "width": width, "split": name, "lighting": split}
            row |= {key: round(getattr(total, key), 2) for key in ("accuracy", "recall", "iou")}
            rows.append(row | {"frames": total.frames})
    return rows


Weights = dict[str, dict[str, list[float]]]  # corruption -> light -> colour's mean weight, a frame each


def look_at_selection(
    network: StairNetV2, frames: StairDataset, indices: Sequence[int]
) -> tuple[Weights, list[dict[str, Any]]]:
    """How much the selective module listens to colour, by corruption and light, and what its choice is worth.

    Args:
        network: in evaluation mode.
        frames: the labelled set.
        indices: of the frames to look at.

    Returns:
        {corruption: {"day": [...], "night": [...]}}: for each frame the mean over channels of colour's weight; depth's
        is the rest to 1. And rows {"split", "iou", "iou_held", "frames"}: per cent with the module's own weights, and
        with those held that it gives to the same frame as drawn.
    """
    import torch

    from perception.inference.preprocess import colour_input, depth_input

    module = network.selective.select
    found: Weights = {}
    counts: dict[str, list[DetectionCounts]] = {}
    with torch.inference_mode():
        for index in indices:
            drawn: torch.Tensor | None = None
            for name in names_for(frames):
                sample = corrupted(frames, index, name)
                inputs = colour_input(sample.rgb[None]), depth_input(sample.depth_m[None])
                rgb, depth = (torch.from_numpy(array) for array in inputs)
                features = network.rgb_branch(rgb), network.depth_branch(depth)
                own = module(network.selective.pooled(*features))
                drawn = own if drawn is None else drawn
                share = torch.softmax(own.view(1, 2, -1), dim=1)[:, 0].mean()
                found.setdefault(name, {}).setdefault(sample.lighting, []).append(float(share))
                grid = encode_grid(sample.lines)
                scores = counts.setdefault(name, [DetectionCounts(), DetectionCounts()])
                for number, pair in enumerate((own, drawn)):
                    handle = module.register_forward_hook(lambda _module, _inputs, _output, pair=pair: pair)
                    try:
                        raw = network.detect(*features)
                    finally:
                        handle.remove()
                    cls, loc = torch.sigmoid(raw.cls_logits)[:, 0].numpy(), raw.loc.movedim(1, -1).numpy()
                    scores[number] += count_cells(cls, loc, grid.cls[None], grid.loc[None])
    rows = [
        {"split": name, "iou": round(own.iou, 2), "iou_held": round(held.iou, 2), "frames": own.frames}
        for name, (own, held) in counts.items()
    ]
    return found, rows


def mean_weights(found: dict[float, Weights]) -> list[dict[str, Any]]:
    """Rows {"width", "split", "lighting", "colour_weight"} of what `look_at_selection` found at each width."""
    return [
        {"width": width, "split": name, "lighting": light, "colour_weight": round(float(np.mean(values)), 3)}
        for width, by_name in found.items()
        for name, by_light in by_name.items()
        for light, values in by_light.items()
    ]


def draw_colour_weights(found: dict[float, Weights]) -> Any:
    """A figure of `look_at_selection` a width, each corruption a row, day and night beside one another.

    Args:
        found: width -> what `look_at_selection` returned first.

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
