"""How detectors are trained: schedules by name."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from perception.data.augmentation import AugmentationConfig
from stair_env.common.field_kinds import naming_fields

SCHEDULES = ("step", "cosine")
Precision = Literal["32-true", "bf16-mixed"]


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
        trust_weight: of the loss that draws the selective module to the modality that tells more
            (`perception.learning.trust`), 0 for none, as in the paper. Needs frozen_statistics.
        dynamic_weights: equations 5 and 6 after each epoch; else the fixed weights of equation 1.
        location_loss: see `perception.learning.losses.detection_loss`.
        positive_weight: see `perception.learning.losses.detection_loss`.
        precision: Lightning's name; "bf16-mixed" is "32-true" on processors without bfloat16 units. Which is faster on
            those with them depends on width and size of the frames (docs/stairnetv2.md).
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
    trust_weight: float = 0.0
    dynamic_weights: bool = True
    location_loss: str = "l2"
    positive_weight: float = 1.0
    precision: Precision = "32-true"
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)

    @naming_fields
    def __post_init__(self) -> None:
        if self.schedule not in SCHEDULES:
            raise ValueError(f"schedule={self.schedule!r} must be one of {', '.join(SCHEDULES)}")
        for name in ("epochs", "batch_size", "small_batch_size", "halve_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}={getattr(self, name)!r} must be at least 1")
        if not 0.0 <= self.small_share <= 1.0:
            raise ValueError(f"small_share={self.small_share!r} must be in [0, 1]")
        if not 0.0 <= self.trust_weight < math.inf:
            raise ValueError(f"trust_weight={self.trust_weight!r} must be a finite number >= 0")
        if self.trust_weight and not self.frozen_statistics:
            raise ValueError("trust_weight needs frozen_statistics, as in the preset robust: it looks at blank frames")

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
    # From weights that know one sensor's depth to any depth (`--start-from`): full size only, statistics as they came.
    "robust": TrainingPreset(
        epochs=30,
        frames_per_epoch=2000,
        batch_size=8,
        learning_rate=1e-3,
        schedule="cosine",
        warmup_epochs=0.3,
        frozen_statistics=True,
        trust_weight=0.1,
        location_loss="l1",
        positive_weight=1.8,
        precision="bf16-mixed",
    ),
}
