"""Random changes of training frames: mirror, shift, turn, photometric, depth, and loss of a whole modality.

The paper mirrors only. The rest makes each branch suffice where the other says nothing or lies: black colour is a night
without any light, missing depth a camera that stares at glass or at the sun, corrupted depth any sensor but the one
that drew the set (`perception.data.depth_corruption`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from perception.data.depth_corruption import corrupt_depth, meaningless_depth
from perception.data.stair_dataset import Sample
from stair_env.common.field_kinds import naming_fields

SPECKLE_LEVELS = (2.0, 12.0)  # standard deviation of added colour noise, grey levels
BLUR_PX = (0.5, 2.5)  # standard deviation of defocus, pixels
SMEAR_PX = (3, 15)  # length of motion blur, pixels
JPEG_QUALITIES = (15, 80)
DARK_LEVEL = 10.0  # mean of 0-255 below which colour alone shows hardly a line
KEPT_IN_THE_DARK = 0.7  # share of such frames that keep their depth all the same


@dataclass(frozen=True)
class AugmentationConfig:
    """Probabilities and strengths.

    Args:
        mirror: probability (0.5 in the paper).
        shift: probability of moving the image by up to shift_px pixels, with zeros behind it.
        shift_px: largest shift right and down, pixels: one cell each way makes every place in a cell equally likely.
        turn: probability of turning and scaling the image about its middle.
        turn_deg: standard deviation of the turn, degrees.
        turn_scale: smallest and largest scale, drawn evenly in the logarithm.
        photometric: probability of changed brightness, contrast, gamma and colour balance.
        grey: probability of losing all colour.
        noise: probability of added colour noise.
        blur, smear, jpeg: probabilities of defocus, of motion blur and of a strongly compressed image.
        matched_depth: share of the frames that take a depth image matched from an infrared pair, where the set has one.
        corrupt_depth: share of the frames whose depth `perception.data.depth_corruption.corrupt_depth` changes.
        drop_colour, drop_depth, other_depth, meaningless_depth: shares of the frames with a black image, without depth,
            with another frame's depth, and with depth that says nothing; no two of them together.

    Raises:
        ValueError: a value is out of range.
    """

    mirror: float = 0.5
    shift: float = 0.5
    shift_px: tuple[int, int] = (32, 16)
    turn: float = 0.3
    turn_deg: float = 5.0
    turn_scale: tuple[float, float] = (0.8, 1.3)
    photometric: float = 0.5
    grey: float = 0.1
    noise: float = 0.2
    blur: float = 0.15
    smear: float = 0.1
    jpeg: float = 0.25
    matched_depth: float = 0.6
    corrupt_depth: float = 0.3
    drop_colour: float = 0.06
    drop_depth: float = 0.2
    other_depth: float = 0.05
    meaningless_depth: float = 0.04

    @naming_fields
    def __post_init__(self) -> None:
        for name in _PROBABILITIES:
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name}={getattr(self, name)!r} must be a probability")
        if sum(getattr(self, name) for name in _EXCLUSIVE) > 1.0 + 1e-9:
            raise ValueError(f"{', '.join(_EXCLUSIVE)} must not sum to more than 1")
        if not 0.0 <= self.turn_deg <= 45.0:
            raise ValueError(f"turn_deg={self.turn_deg!r} must be in [0, 45]")
        low, high = self.turn_scale
        if not 0.25 <= low <= high <= 4.0:
            raise ValueError(f"turn_scale={self.turn_scale!r} must rise within [0.25, 4]")

    @classmethod
    def paper(cls) -> AugmentationConfig:
        """The random mirror alone."""
        off: dict[str, Any] = {name: 0.0 for name in _PROBABILITIES if name != "mirror"}
        return cls(**off)


_EXCLUSIVE = ("drop_colour", "drop_depth", "other_depth", "meaningless_depth")
_PROBABILITIES = (
    "mirror", "shift", "turn", "photometric", "grey", "noise", "blur", "smear", "jpeg",
    "matched_depth", "corrupt_depth", *_EXCLUSIVE,
)  # fmt: skip


def augment(
    sample: Sample,
    config: AugmentationConfig,
    rng: np.random.Generator,
    draw_other_depth: Callable[[], np.ndarray] | None = None,
) -> Sample:
    """A randomly changed copy; the labels follow the image.

    Args:
        sample: the frame.
        config: what to do how often.
        rng: the source of all chance.
        draw_other_depth: another frame's depth, for `other_depth`; None leaves the frame its own.
    """
    if rng.random() < config.mirror:
        sample = mirrored(sample)
    if rng.random() < config.turn:
        low, high = np.log(config.turn_scale)
        sample = turned(sample, float(rng.normal(0.0, config.turn_deg)), float(np.exp(rng.uniform(low, high))))
    if rng.random() < config.shift:
        right, down = (int(rng.integers(-limit, limit + 1)) for limit in config.shift_px)
        sample = shifted(sample, right, down)
    rgb, depth = _change_colour(sample.rgb, config, rng), sample.depth_m
    if rng.random() < config.corrupt_depth:
        depth = corrupt_depth(depth, rng)
    fates = np.cumsum([getattr(config, name) for name in _EXCLUSIVE])
    fate = int(np.searchsorted(fates, rng.random(), side="right"))
    if fate in (1, 2, 3) and rgb.mean() < DARK_LEVEL and rng.random() < KEPT_IN_THE_DARK:
        fate = len(fates)  # neither colour nor depth would say anything
    if fate == 0:
        rgb = np.zeros_like(rgb)
    elif fate == 1:
        depth = np.zeros_like(depth)
    elif fate == 2 and draw_other_depth is not None:
        depth = draw_other_depth()
    elif fate == 3:
        depth = meaningless_depth(depth.shape, rng)
    return replace(sample, rgb=rgb, depth_m=depth)


def mirrored(sample: Sample) -> Sample:
    """Left and right swapped."""
    width = sample.rgb.shape[1]
    x1, y1, x2, y2 = sample.lines.reshape(-1, 4).T
    return replace(
        sample,
        rgb=np.ascontiguousarray(sample.rgb[:, ::-1]),
        depth_m=np.ascontiguousarray(sample.depth_m[:, ::-1]),
        lines=np.stack([width - x2, y2, width - x1, y1], axis=-1),
    )


def shifted(sample: Sample, right: int, down: int) -> Sample:
    """Moved by whole pixels; what comes in is black and without reading. Lines may reach beyond the image."""
    lines = sample.lines.reshape(-1, 4) + np.array([right, down, right, down], dtype=np.float64)
    return replace(
        sample, rgb=_moved(sample.rgb, right, down), depth_m=_moved(sample.depth_m, right, down), lines=lines
    )


def turned(sample: Sample, degrees: float, scale: float) -> Sample:
    """Turned counter-clockwise about the middle and scaled; what comes in is black and without reading."""
    height, width = sample.depth_m.shape
    matrix = cv2.getRotationMatrix2D((width / 2 - 0.5, height / 2 - 0.5), degrees, scale)
    size = (width, height)
    corner = matrix[:, :2] @ [-0.5, -0.5] + matrix[:, 2] + 0.5  # labels count from the corner, pixels from their centre
    ends = sample.lines.reshape(-1, 2, 2) @ matrix[:, :2].T + corner
    return replace(
        sample,
        rgb=cv2.warpAffine(sample.rgb, matrix, size, flags=cv2.INTER_LINEAR),
        depth_m=cv2.warpAffine(sample.depth_m, matrix, size, flags=cv2.INTER_NEAREST),
        lines=ends.reshape(-1, 4),
    )


def _moved(image: np.ndarray, right: int, down: int) -> np.ndarray:
    height, width = image.shape[:2]
    out = np.zeros_like(image)
    to_rows, to_columns = slice(max(down, 0), height + min(down, 0)), slice(max(right, 0), width + min(right, 0))
    from_rows, from_columns = slice(max(-down, 0), height - max(down, 0)), slice(max(-right, 0), width - max(right, 0))
    out[to_rows, to_columns] = image[from_rows, from_columns]
    return out


def _change_colour(rgb: np.ndarray, config: AugmentationConfig, rng: np.random.Generator) -> np.ndarray:
    if rng.random() < config.photometric:
        gamma, contrast = np.exp(rng.normal(0.0, 0.25)), np.exp(rng.normal(0.0, 0.2))
        gains = np.exp(rng.normal(0.0, 0.15) + rng.normal(0.0, 0.06, 3))
        level = np.linspace(0.0, 1.0, 256)[:, None] ** gamma
        table = np.clip(((level - 0.4) * contrast + 0.4) * gains * 255.0, 0.0, 255.0) * (level > 0.0)
        rgb = cv2.LUT(rgb, table.astype(np.uint8)[None])
    if rng.random() < config.grey:
        rgb = cv2.cvtColor(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    if rng.random() < config.blur:
        rgb = cv2.GaussianBlur(rgb, (0, 0), rng.uniform(*BLUR_PX))
    if rng.random() < config.smear:
        rgb = cv2.filter2D(rgb, -1, _smear_kernel(rng))
    if rng.random() < config.noise:
        noise = rng.standard_normal(rgb.shape, dtype=np.float32) * np.float32(rng.uniform(*SPECKLE_LEVELS))
        rgb = np.clip(rgb + noise, 0, 255).astype(np.uint8)
    if rng.random() < config.jpeg:
        _, data = cv2.imencode(".jpg", rgb, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(*JPEG_QUALITIES))])
        rgb = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR))
    return rgb


def _smear_kernel(rng: np.random.Generator) -> np.ndarray:
    """Weights of a straight smear in a random direction."""
    length, angle = int(rng.integers(*SMEAR_PX)), rng.uniform(0.0, np.pi)
    kernel = np.zeros((length, length), np.float32)
    middle = (length - 1) / 2.0
    step = np.array([np.cos(angle), np.sin(angle)]) * middle
    start, end = (tuple(round(part) for part in middle + sign * step) for sign in (-1.0, 1.0))
    cv2.line(kernel, start, end, 1.0)
    return kernel / kernel.sum()
