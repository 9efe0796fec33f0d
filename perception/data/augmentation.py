"""Random changes of training frames: mirror, shift, photometric, depth, and loss of a whole modality.

The paper mirrors only. The rest keeps either branch able to carry the scene alone: black colour is a night without
any light, missing depth a camera that stares at glass or at the sun.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from perception.data.stair_dataset import Sample

MAX_HOLES = 4
MAX_HOLE_PX = 96
SPECKLE_LEVELS = (2.0, 12.0)  # standard deviation of added colour noise, grey levels


@dataclass(frozen=True)
class AugmentationConfig:
    """Probabilities and strengths.

    Args:
        mirror: probability (0.5 in the paper).
        shift: probability of moving the image by up to shift_px pixels, with zeros behind it.
        shift_px: largest shift right and down, pixels: one cell each way makes every place in a cell equally likely.
        photometric: probability of changed brightness, contrast, gamma and colour balance.
        grey: probability of losing all colour.
        noise: probability of added colour noise.
        depth_scale: standard deviation of a relative depth error of the whole frame.
        depth_holes: probability of a few rectangles without depth.
        drop_colour, drop_depth: probability of a black image and of no depth at all; never both.

    Raises:
        ValueError: a value is out of range.
    """

    mirror: float = 0.5
    shift: float = 0.5
    shift_px: tuple[int, int] = (32, 16)
    photometric: float = 0.5
    grey: float = 0.05
    noise: float = 0.15
    depth_scale: float = 0.01
    depth_holes: float = 0.15
    drop_colour: float = 0.08
    drop_depth: float = 0.08

    def __post_init__(self) -> None:
        names = ("mirror", "shift", "photometric", "grey", "noise", "depth_holes", "drop_colour", "drop_depth")
        for name in names:
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name}={getattr(self, name)!r} must be a probability")
        if self.drop_colour + self.drop_depth > 1.0:
            raise ValueError("drop_colour and drop_depth must not sum to more than 1")
        if not 0.0 <= self.depth_scale < 0.5:
            raise ValueError(f"depth_scale={self.depth_scale!r} must be in [0, 0.5)")

    @classmethod
    def paper(cls) -> AugmentationConfig:
        """The random mirror alone."""
        return cls(
            shift=0.0,
            photometric=0.0,
            grey=0.0,
            noise=0.0,
            depth_scale=0.0,
            depth_holes=0.0,
            drop_colour=0.0,
            drop_depth=0.0,
        )


def augment(sample: Sample, config: AugmentationConfig, rng: np.random.Generator) -> Sample:
    """A randomly changed copy; the labels follow the image."""
    if rng.random() < config.mirror:
        sample = mirrored(sample)
    if rng.random() < config.shift:
        right, down = (int(rng.integers(-limit, limit + 1)) for limit in config.shift_px)
        sample = shifted(sample, right, down)
    rgb, depth = _change_colour(sample.rgb, config, rng), _change_depth(sample.depth_m, config, rng)
    draw = rng.random()
    if draw < config.drop_colour:
        rgb = np.zeros_like(rgb)
    elif draw < config.drop_colour + config.drop_depth:
        depth = np.zeros_like(depth)
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
    if rng.random() < config.noise:
        noise = rng.standard_normal(rgb.shape, dtype=np.float32) * np.float32(rng.uniform(*SPECKLE_LEVELS))
        rgb = np.clip(rgb + noise, 0, 255).astype(np.uint8)
    return rgb


def _change_depth(depth_m: np.ndarray, config: AugmentationConfig, rng: np.random.Generator) -> np.ndarray:
    depth = depth_m * np.float32(1.0 + config.depth_scale * rng.standard_normal())
    if rng.random() < config.depth_holes:
        for _ in range(int(rng.integers(1, MAX_HOLES + 1))):
            height, width = rng.integers(4, MAX_HOLE_PX, 2)
            row, column = rng.integers(0, depth.shape[0]), rng.integers(0, depth.shape[1])
            depth[row : row + height, column : column + width] = 0.0
    return depth
