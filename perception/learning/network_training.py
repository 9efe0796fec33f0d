"""Trains detectors with Lightning: presets, frames as batches, the training module of StairNetV2.

The paper's opponents train by the same means (`perception.reproduction.baselines.baseline_training`).

An epoch here is a fixed number of frames, so that on a CPU a checkpoint is written every few minutes. Everything an
epoch draws comes from (seed, epoch), so a resumed run sees the frames that an uninterrupted one would have seen.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import lightning as L
import numpy as np
import torch
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from lightning.pytorch.loggers import TensorBoardLogger
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset, Sampler

from perception.data.augmentation import AugmentationConfig, augment
from perception.data.label_grid import encode_grid
from perception.data.stair_dataset import Sample, StairDataset
from perception.inference.preprocess import colour_input, depth_input
from perception.learning.losses import GridTargets, LossWeights, detection_loss, location_errors, total_loss
from perception.learning.metrics import DetectionCounts, count_cells
from perception.network import StairNetV2
from stair_env.common.constants import IMAGE_SIZE

LOGGER = logging.getLogger(__name__)
Batch = tuple[Tensor, ...]  # rgb, depth, cls, loc for StairNetV2
Encoder = Callable[[Sample], tuple[np.ndarray, ...]]  # a frame at full or half size -> input and targets
SCHEDULES = ("step", "cosine")


@dataclass(frozen=True)
class TrainingPreset:
    """How to train.

    Args:
        epochs: number of epochs.
        frames_per_epoch: frames an epoch, None for the whole set.
        batch_size: frames a step at 512 pixels.
        learning_rate: Adam's, at its largest.
        weight_decay: Adam's.
        schedule: "step" halves the rate every halve_every epochs, "cosine" warms up and falls to 1 % over the run.
        halve_every: epochs.
        warmup_epochs: of "cosine".
        small_share: share of the epochs, from the first, that see frames at half size. They cost a quarter and
            teach nearly the same features.
        small_batch_size: frames a step during those.
        frozen_statistics: whether batch norms keep the mean and variance they came with, for fine-tuning: frames
            without colour or depth make those of small batches jump, and a network in use sees neither.
        dynamic_weights: equations 5 and 6 after each epoch; else the fixed weights of equation 1.
        location_loss: see `perception.learning.losses.detection_loss`.
        positive_weight: see `perception.learning.losses.detection_loss`.
        precision: Lightning's name; "bf16-mixed" halves the time of a step on CPUs with bfloat16 units.
        augmentation: of the frames.

    Raises:
        ValueError: a field is out of range.
    """

    epochs: int
    frames_per_epoch: int | None = None
    batch_size: int = 4
    learning_rate: float = 1e-3
    weight_decay: float = 1e-6
    schedule: Literal["step", "cosine"] = "step"
    halve_every: int = 50
    warmup_epochs: float = 1.0
    small_share: float = 0.0
    small_batch_size: int = 16
    frozen_statistics: bool = False
    dynamic_weights: bool = True
    location_loss: str = "l2"
    positive_weight: float = 1.0
    precision: Literal["32-true", "bf16-mixed"] = "32-true"
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)

    def __post_init__(self) -> None:
        if self.schedule not in SCHEDULES:
            raise ValueError(f"schedule={self.schedule!r} must be one of {', '.join(SCHEDULES)}")
        for name in ("epochs", "batch_size", "small_batch_size", "halve_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}={getattr(self, name)!r} must be at least 1")
        if not 0.0 <= self.small_share <= 1.0:
            raise ValueError(f"small_share={self.small_share!r} must be in [0, 1]")

    def is_small(self, epoch: int) -> bool:
        """Whether an epoch sees frames at half size."""
        return epoch < round(self.small_share * self.epochs)

    def rate(self, progress_epochs: float) -> float:
        """Learning rate after so many epochs, fractions included."""
        if self.schedule == "step":
            return self.learning_rate * 0.5 ** (int(progress_epochs) // self.halve_every)
        if progress_epochs < self.warmup_epochs:
            return self.learning_rate * max(progress_epochs / self.warmup_epochs, 0.01)
        share = min((progress_epochs - self.warmup_epochs) / max(self.epochs - self.warmup_epochs, 1e-9), 1.0)
        return self.learning_rate * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * share)))


PRESETS: dict[str, TrainingPreset] = {
    # Experimental settings of the paper: 200 epochs, Adam 1e-3 halved every 50, weight decay 1e-6, batch 4, mirror.
    "paper": TrainingPreset(epochs=200, augmentation=AugmentationConfig.paper()),
    # About 90 minutes of one CPU core with bfloat16 units at width 0.25.
    "fast": TrainingPreset(
        epochs=40,
        frames_per_epoch=1200,
        batch_size=8,
        learning_rate=3e-3,
        schedule="cosine",
        small_share=0.5,
        location_loss="l1",
        positive_weight=1.8,
        precision="bf16-mixed",
    ),
}


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
    """

    def __init__(
        self,
        frames: StairDataset,
        augmentation: AugmentationConfig | None,
        size: int = IMAGE_SIZE,
        seed: int = 0,
        epoch: int = 0,
        encode: Encoder = as_arrays,
    ) -> None:
        self._frames, self._augmentation, self._size = frames, augmentation, size
        self._seed, self._epoch, self._encode = seed, epoch, encode

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Batch:
        sample = self._frames[index]
        if self._augmentation is not None:
            rng = np.random.default_rng([self._seed, self._epoch, index])
            sample = augment(sample, self._augmentation, rng)
        arrays = self._encode(halved(sample) if self._size < IMAGE_SIZE else sample)
        return tuple(torch.from_numpy(array) for array in arrays)


class EpochSampler(Sampler[int]):
    """A random part of the set, a function of (seed, epoch); no frame twice within an epoch."""

    def __init__(self, size: int, count: int | None, seed: int, epoch: int) -> None:
        order = np.random.default_rng([seed, epoch]).permutation(size)
        self._order: list[int] = order[:count].tolist()

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
    """

    def __init__(
        self,
        root: Path,
        preset: TrainingPreset,
        seed: int = 0,
        workers: int = 0,
        validation_frames: int | None = 200,
        encode: Encoder = as_arrays,
    ) -> None:
        super().__init__()
        self._preset, self._seed, self._workers, self._encode = preset, seed, workers, encode
        self._train, self._val = StairDataset(root, "train"), StairDataset(root, "val")
        self._validation_frames = validation_frames

    def _size(self, epoch: int) -> int:
        return IMAGE_SIZE // 2 if self._preset.is_small(epoch) else IMAGE_SIZE

    def train_dataloader(self) -> DataLoader[Batch]:
        """Batches of the current epoch."""
        epoch = self.trainer.current_epoch if self.trainer is not None else 0
        preset = self._preset
        frames = GridFrames(self._train, preset.augmentation, self._size(epoch), self._seed, epoch, self._encode)
        batch = preset.small_batch_size if preset.is_small(epoch) else preset.batch_size
        sampler = EpochSampler(len(frames), preset.frames_per_epoch, self._seed, epoch)
        return DataLoader(frames, batch, sampler=sampler, num_workers=self._workers, drop_last=len(sampler) > batch)

    def val_dataloader(self) -> DataLoader[Batch]:
        """The same frames after every epoch, spread evenly over the set, at the last epoch's size."""
        frames = GridFrames(self._val, None, self._size(self._preset.epochs - 1), encode=self._encode)
        count = min(self._validation_frames or len(frames), len(frames))
        chosen = np.linspace(0, len(frames) - 1, count).round().astype(int).tolist()
        return DataLoader(frames, 8, sampler=chosen, num_workers=self._workers)


class DetectorTraining(L.LightningModule):
    """The preset's optimiser and schedule around a detector; loss and validation are a subclass's.

    A subclass logs `val/iou`, by which `train` keeps the best checkpoint.

    Args:
        network: to train.
        preset: how to train.
    """

    network: nn.Module

    def __init__(self, network: nn.Module, preset: TrainingPreset) -> None:
        super().__init__()
        self.network, self.preset = network, preset

    def configure_optimizers(self) -> Any:
        """Adam, its rate set before every step by `on_train_batch_start`."""
        return torch.optim.Adam(self.parameters(), lr=self.preset.learning_rate, weight_decay=self.preset.weight_decay)

    def on_train_epoch_start(self) -> None:
        """Freeze what the preset freezes; the trainer puts all modules into training mode before."""
        if self.preset.frozen_statistics:
            for module in self.network.modules():
                if isinstance(module, nn.BatchNorm2d):
                    module.eval()

    def on_train_batch_start(self, batch: Batch, batch_index: int) -> None:
        """Set the learning rate from the progress, which a resumed run knows."""
        steps = max(self.trainer.num_training_batches, 1)
        rate = self.preset.rate(self.current_epoch + batch_index / steps)
        for group in self.trainer.optimizers[0].param_groups:
            group["lr"] = rate


class StairNetTraining(DetectorTraining):
    """Loss, dynamic weights and validation around StairNetV2.

    Args:
        width: of the network.
        preset: how to train.
        fusion_stage: of the network.
    """

    network: StairNetV2

    def __init__(self, width: float, preset: TrainingPreset, fusion_stage: int = 2) -> None:
        network = StairNetV2(width, fusion_stage).use_dense_convolutions(not torch.cuda.is_available())
        super().__init__(network, preset)
        self.loss_weights = LossWeights() if preset.dynamic_weights else LossWeights.fixed()
        self._counts = DetectionCounts()
        self._errors = np.zeros(2)

    def training_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Equation 2 over a batch."""
        rgb, depth, cls, loc = batch
        raw = self.network.forward_raw(rgb, depth)
        raw = type(raw)(raw.cls_logits.float(), raw.loc.float())
        preset = self.preset
        terms = detection_loss(raw, GridTargets(cls, loc), preset.location_loss, preset.positive_weight)
        loss = total_loss(terms, self.loss_weights)
        self.log_dict({f"loss/{name}": term.detach() for name, term in terms.items()})
        self.log("loss/total", loss.detach(), prog_bar=True)
        return loss

    def on_validation_epoch_start(self) -> None:
        """Count from zero."""
        self._counts, self._errors = DetectionCounts(), np.zeros(2)

    def validation_step(self, batch: Batch, batch_index: int) -> None:
        """Equations 3, 4 and 10 over a batch."""
        rgb, depth, cls, loc = batch
        score, place = (output.float() for output in self.network(rgb, depth))
        self._errors += location_errors(place, GridTargets(cls, loc))
        predicted, true = (x.movedim(1, -1).cpu().numpy() for x in (place, loc))
        self._counts += count_cells(score[:, 0].cpu().numpy(), predicted, cls[:, 0].cpu().numpy(), true)

    def on_validation_epoch_end(self) -> None:
        """Log the metrics, and shift the loss weights when a training epoch has gone before."""
        counts = self._counts
        self.log_dict({"val/accuracy": counts.accuracy, "val/recall": counts.recall})
        self.log("val/iou", counts.iou, prog_bar=True)
        self.log_dict({"weights/x": self.loss_weights.x, "weights/y": self.loss_weights.y})
        if self.preset.dynamic_weights and not self.trainer.sanity_checking:
            self.loss_weights = self.loss_weights.updated(*self._errors.tolist())

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep the dynamic weights."""
        checkpoint["loss_weights"] = (self.loss_weights.x, self.loss_weights.y)

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Take them up again."""
        self.loss_weights = LossWeights(*checkpoint["loss_weights"])


class EpochLine(Callback):
    """One log line an epoch."""

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Log what the epoch brought."""
        if not trainer.sanity_checking:
            metrics = {name: round(float(value), 4) for name, value in trainer.callback_metrics.items()}
            LOGGER.info("epoch %d: %s", trainer.current_epoch, metrics)


def train(
    module: DetectorTraining,
    frames: FrameModule,
    output: Path,
    *,
    resume: bool = False,
    progress: bool = True,
) -> None:
    """Train, writing checkpoints and TensorBoard events; leaves `module.network` in evaluation mode.

    Args:
        module: the network and how to train it.
        frames: the data.
        output: folder for checkpoints (`last.ckpt` after every epoch, `best.ckpt` by validation IOU) and events.
        resume: go on from `last.ckpt` when there is one.
        progress: whether to show a bar.
    """
    # Channels-last must stay off while training: torch's CPU kernels for dilated grouped convolutions corrupt memory.
    last = output / "last.ckpt"
    keep = [
        ModelCheckpoint(output, filename="best", monitor="val/iou", mode="max", enable_version_counter=False),
        ModelCheckpoint(output, filename="last", save_top_k=1, monitor=None, enable_version_counter=False),
    ]
    trainer = L.Trainer(
        accelerator="auto",
        precision=module.preset.precision,
        max_epochs=module.preset.epochs,
        default_root_dir=output,
        callbacks=[*keep, EpochLine()],
        logger=TensorBoardLogger(output, name="events", version=0),
        enable_progress_bar=progress,
        enable_model_summary=False,
        num_sanity_val_steps=0,
        reload_dataloaders_every_n_epochs=1,
        log_every_n_steps=10,
    )
    with _flushed_denormals():
        trainer.fit(module, datamodule=frames, ckpt_path=str(last) if resume and last.is_file() else None)
    module.network.eval()


@contextmanager
def _flushed_denormals() -> Iterator[None]:
    """Denormal activations of dying channels slow a CPU down many times; the mode is the whole process's."""
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)
