"""Frames of a data set as batches of a network's input and targets, for training and validation.

Everything an epoch draws comes from (seed, epoch), so a resumed run sees the frames that an uninterrupted one would
have seen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from perception.data.augmentation import AugmentationConfig, augment
from perception.data.depth_corruption import corrupt_depth
from perception.data.label_grid import encode_grid
from perception.data.stair_dataset import Sample, StairDataset
from perception.inference.preprocess import colour_input, depth_input
from perception.learning.presets import TrainingPreset
from stair_env.common.constants import IMAGE_SIZE

Batch = tuple[Tensor, ...]  # rgb, depth, cls, loc for StairNetV2
Encoder = Callable[[Sample], tuple[np.ndarray, ...]]  # a frame at full or half size -> input and targets
CONDITIONS = ("model", "matched", "colour", "corrupted")  # depth as drawn, matched, none at all, corrupted


def halved(sample: Sample) -> Sample:
    """A frame at half size; its labels too."""
    import cv2

    height, width = sample.depth_m.shape
    rgb = cv2.resize(sample.rgb, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    return Sample(rgb, np.ascontiguousarray(sample.depth_m[1::2, 1::2]), sample.kinds, sample.lines / 2, sample.meta)


def as_arrays(sample: Sample) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """rgb (3, H, W), depth (1, H, W), cls (1, H / 16, W / 32), loc (8, H / 16, W / 32), all float32."""
    height, width = sample.depth_m.shape
    grid = encode_grid(sample.lines, rows=height // 16, columns=width // 32)
    rgb, depth = colour_input(sample.rgb[None])[0], depth_input(sample.depth_m[None])[0]
    return rgb, depth, grid.cls[None], np.ascontiguousarray(np.moveaxis(grid.loc, -1, 0))


class GridFrames(Dataset[Batch]):
    """Augmented frames as the network's input and targets.

    Args:
        frames: the labelled frames.
        augmentation: None for frames as they are.
        size: 512, or 256 for frames at half size.
        seed: with the epoch and the index, seeds each frame's augmentation.
        epoch: see seed.
        encode: makes input and targets of a frame.
        condition: which depth a frame has without augmentation, one of `CONDITIONS`.
    """

    def __init__(
        self,
        frames: StairDataset,
        augmentation: AugmentationConfig | None,
        size: int = IMAGE_SIZE,
        seed: int = 0,
        epoch: int = 0,
        encode: Encoder = as_arrays,
        condition: str = "model",
    ) -> None:
        self._frames, self._augmentation, self._size = frames, augmentation, size
        self._seed, self._epoch, self._encode, self._condition = seed, epoch, encode, condition

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Batch:
        if self._augmentation is None:
            sample = self._conditioned(index)
        else:
            rng = np.random.default_rng([self._seed, self._epoch, index])
            sample = self._frames.frame(index, self._depth_folder(rng))
            sample = augment(sample, self._augmentation, rng, lambda: self._other_depth(rng))
        arrays = self._encode(halved(sample) if self._size < IMAGE_SIZE else sample)
        return tuple(torch.from_numpy(array) for array in arrays)

    def _conditioned(self, index: int) -> Sample:
        """A frame for validation."""
        if self._condition == "matched":
            return self._frames.frame(index, self._frames.matched_folders[0])
        sample = self._frames[index]
        if self._condition == "colour":
            return replace(sample, depth_m=np.zeros_like(sample.depth_m))
        if self._condition == "corrupted":
            return replace(sample, depth_m=corrupt_depth(sample.depth_m, np.random.default_rng(index)))
        return sample

    def _depth_folder(self, rng: np.random.Generator) -> str:
        """Which depth image of a frame is taken."""
        folders, draw = self._frames.matched_folders, rng.random()
        if not folders or self._augmentation is None or draw >= self._augmentation.matched_depth:
            return "depthes"
        return str(rng.choice(list(folders)))

    def _other_depth(self, rng: np.random.Generator) -> np.ndarray:
        """The depth of another frame."""
        return self._frames.depth(int(rng.integers(len(self._frames))), self._depth_folder(rng))


class EpochSampler(Sampler[int]):
    """A random part of the set, a function of (seed, epoch); no frame twice within an epoch.

    Args:
        size: of the set.
        count: frames of the part; None for all.
        seed, epoch: see above.
        rank, devices: of several processes each takes every so-manieth frame, all equally many.
    """

    def __init__(self, size: int, count: int | None, seed: int, epoch: int, rank: int = 0, devices: int = 1) -> None:
        order = np.random.default_rng([seed, epoch]).permutation(size)[:count]
        self._order: list[int] = order[: len(order) // devices * devices][rank::devices].tolist()

    def __len__(self) -> int:
        return len(self._order)

    def __iter__(self) -> Any:
        return iter(self._order)


class FrameModule(L.LightningDataModule):
    """Training and validation frames of a data set on disk.

    Args:
        root: folder with `train` and `val`.
        preset: how to train.
        seed: of order and augmentation.
        workers: processes that read frames; 0 reads in the training process.
        validation_frames: at most so many of `val` after each epoch; None for all.
        encode: makes a network's input and targets of a frame; StairNetV2's by default.
        conditions: depth of the validation frames, of `CONDITIONS`; each is a loader of its own. "matched" is left out
            where the set has no matched depth.
    """

    def __init__(
        self,
        root: Path,
        preset: TrainingPreset,
        seed: int = 0,
        workers: int = 0,
        validation_frames: int | None = 200,
        encode: Encoder = as_arrays,
        conditions: tuple[str, ...] = ("model",),
    ) -> None:
        super().__init__()
        self._preset, self._seed, self._workers, self._encode = preset, seed, workers, encode
        self._train, self._val = StairDataset(root, "train"), StairDataset(root, "val")
        self._validation_frames = validation_frames
        self.conditions = tuple(c for c in conditions if c != "matched" or self._val.matched_folders)

    def _size(self, epoch: int) -> int:
        return IMAGE_SIZE // 2 if self._preset.is_small(epoch) else IMAGE_SIZE

    def _place(self) -> tuple[int, int]:
        """Which of how many processes this is; each trains on its share of every batch."""
        return (self.trainer.global_rank, self.trainer.world_size) if self.trainer is not None else (0, 1)

    def train_dataloader(self) -> DataLoader[Batch]:
        """Batches of the current epoch."""
        epoch = self.trainer.current_epoch if self.trainer is not None else 0
        preset, (rank, devices) = self._preset, self._place()
        frames = GridFrames(self._train, preset.augmentation, self._size(epoch), self._seed, epoch, self._encode)
        batch = (preset.small_batch_size if preset.is_small(epoch) else preset.batch_size) // devices
        sampler = EpochSampler(len(frames), preset.frames_per_epoch, self._seed, epoch, rank, devices)
        return DataLoader(frames, batch, sampler=sampler, num_workers=self._workers, drop_last=len(sampler) > batch)

    def val_dataloader(self) -> list[DataLoader[Batch]]:
        """The same frames after every epoch, spread evenly over the set, at the last epoch's size; one a condition."""
        size, loaders = self._size(self._preset.epochs - 1), []
        for condition in self.conditions:
            frames = GridFrames(self._val, None, size, encode=self._encode, condition=condition)
            count = min(self._validation_frames or len(frames), len(frames))
            rank, devices = self._place()
            chosen = np.linspace(0, len(frames) - 1, count).round().astype(int)[rank::devices].tolist()
            loaders.append(DataLoader(frames, 8, sampler=chosen, num_workers=self._workers))
        return loaders
