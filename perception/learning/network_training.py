"""Trains detectors with Lightning: presets, frames as batches, the training module of StairNetV2.

The paper's opponents train by the same means (`perception.reproduction.baselines.baseline_training`).

An epoch here is a fixed number of frames, so that on a CPU a checkpoint is written every few minutes. Everything an
epoch draws comes from (seed, epoch), so a resumed run sees the frames that an uninterrupted one would have seen.
"""

from __future__ import annotations

import dataclasses
import logging
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import torch
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from lightning.pytorch.loggers import TensorBoardLogger
from torch import Tensor, nn

from perception.learning.frames import Batch, FrameModule
from perception.learning.losses import GridTargets, LossWeights, detection_loss, location_errors, total_loss
from perception.learning.metrics import DetectionCounts, count_cells
from perception.learning.presets import Precision, TrainingPreset
from perception.learning.trust import FIT_FRAMES, SelectionFit, colour_share, trust_loss
from perception.network import StairNetV2, use_compiled_convolutions, use_merged_norms

TRUST_EVERY = 2  # steps: asking for both modalities alone takes two fifths of a step more

LOGGER = logging.getLogger(__name__)


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

    def summed(self, values: np.ndarray) -> np.ndarray:
        """An array of counts or sums, added up over all processes that train."""
        if self.trainer.world_size == 1:
            return values
        together = self.all_gather(torch.as_tensor(np.asarray(values, dtype=np.float64), device=self.device))
        total: np.ndarray = together.sum(dim=0).cpu().numpy()  # type: ignore[union-attr]
        return total

    def configure_optimizers(self) -> Any:
        """Adam, its rate set before every step by `on_train_batch_start`."""
        return torch.optim.Adam(self.parameters(), lr=self.preset.learning_rate, weight_decay=self.preset.weight_decay)

    def on_train_epoch_start(self) -> None:
        """Freeze what the preset freezes; the trainer puts all modules into training mode before."""
        if self.preset.frozen_statistics:
            for module in self.network.modules():
                if isinstance(module, nn.BatchNorm2d):
                    module.eval()
            use_merged_norms(self.network)

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
        network: trained instead of one that is made of width and fusion_stage.
    """

    network: StairNetV2

    def __init__(
        self, width: float, preset: TrainingPreset, fusion_stage: int = 2, network: StairNetV2 | None = None
    ) -> None:
        trained = network if network is not None else StairNetV2(width, fusion_stage)
        super().__init__(trained.use_dense_convolutions(not torch.cuda.is_available()), preset)
        self.loss_weights = LossWeights() if preset.dynamic_weights else LossWeights.fixed()
        self._counts: dict[int, DetectionCounts] = {}
        self._errors = np.zeros(2)

    def on_train_start(self) -> None:
        """Give the selective module a start, if it is to be taught which modality to trust."""
        if self.preset.trust_weight > 0.0 and self.current_epoch == 0:
            self._fit_selection()

    @torch.no_grad()
    def _fit_selection(self) -> None:
        module, network = self.network.selective, self.network.eval()
        fit = SelectionFit(module.select.in_features)
        batches = self.trainer.datamodule.train_dataloader()  # type: ignore[attr-defined]
        seen = 0
        for batch in batches:
            rgb, depth, cls, loc = (tensor.to(self.device) for tensor in batch)
            features = network.rgb_branch(rgb), network.depth_branch(depth)
            fit.add(module.pooled(*features), self._colour_share(features, GridTargets(cls, loc)))
            seen += len(rgb)
            if seen * self.trainer.world_size >= FIT_FRAMES:
                break
        network.train()
        fit.moments = self.summed(fit.moments)
        LOGGER.info("selective module: %.0f %% of what to trust explained", 100.0 * fit.apply(module))

    def _colour_share(self, features: tuple[Tensor, Tensor], targets: GridTargets) -> Tensor:
        preset, weights = self.preset, self.loss_weights
        return colour_share(self.network, *features, targets, weights, preset.location_loss, preset.positive_weight)

    def training_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Equation 2 over a batch."""
        rgb, depth, cls, loc = batch
        preset, targets, network = self.preset, GridTargets(cls, loc), self.network
        asked = preset.trust_weight > 0.0 and batch_index % TRUST_EVERY == 0
        features = (network.rgb_branch(rgb), network.depth_branch(depth)) if asked else None
        raw = network.detect(*features) if features else network.forward_raw(rgb, depth)
        raw = type(raw)(raw.cls_logits.float(), raw.loc.float())
        terms = detection_loss(raw, targets, preset.location_loss, preset.positive_weight)
        loss = total_loss(terms, self.loss_weights)
        if features:
            terms["trust"] = trust_loss(network.selective.logits(*features), self._colour_share(features, targets))
            loss = loss + TRUST_EVERY * preset.trust_weight * terms["trust"]
        self.log_dict({f"loss/{name}": term.detach() for name, term in terms.items()})
        self.log("loss/total", loss.detach(), prog_bar=True)
        return loss

    def on_validation_epoch_start(self) -> None:
        """Count from zero."""
        self._counts, self._errors = {}, np.zeros(2)

    def validation_step(self, batch: Batch, batch_index: int, dataloader_idx: int = 0) -> None:
        """Equations 3, 4 and 10 over a batch."""
        rgb, depth, cls, loc = batch
        score, place = (output.float() for output in self.network(rgb, depth))
        self._errors += location_errors(place, GridTargets(cls, loc))
        predicted, true = (x.movedim(1, -1).cpu().numpy() for x in (place, loc))
        counts = count_cells(score[:, 0].cpu().numpy(), predicted, cls[:, 0].cpu().numpy(), true)
        self._counts[dataloader_idx] = self._counts.get(dataloader_idx, DetectionCounts()) + counts

    def on_validation_epoch_end(self) -> None:
        """Log the metrics, and shift the loss weights when a training epoch has gone before."""
        conditions = getattr(self.trainer.datamodule, "conditions", ("",))  # type: ignore[attr-defined]
        own = [dataclasses.astuple(self._counts.get(i, DetectionCounts())) for i in range(len(conditions))]
        by_condition = [DetectionCounts(*map(int, row)) for row in self.summed(np.array(own))]
        counts = sum(by_condition, DetectionCounts())
        if len(conditions) > 1:
            self.log_dict({f"val/iou_{name}": by_condition[i].iou for i, name in enumerate(conditions)})
        self.log_dict({"val/accuracy": counts.accuracy, "val/recall": counts.recall})
        self.log("val/iou", counts.iou, prog_bar=True)
        self.log_dict({"weights/x": self.loss_weights.x, "weights/y": self.loss_weights.y})
        if self.preset.dynamic_weights and not self.trainer.sanity_checking:
            self.loss_weights = self.loss_weights.updated(*self.summed(self._errors).tolist())

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
    accelerator: str = "auto",
    devices: int = 1,
) -> None:
    """Train, writing checkpoints and TensorBoard events; leaves `module.network` in evaluation mode.

    Args:
        module: the network and how to train it.
        frames: the data.
        output: folder for checkpoints (`last.ckpt` after every epoch, `best.ckpt` by validation IOU) and events.
        resume: go on from `last.ckpt` when there is one.
        progress: whether to show a bar.
        accelerator: Lightning's name, "cpu", "gpu" or "auto".
        devices: processes that share every batch, on a graphics card each (or all on the processor).

    Raises:
        ValueError: a batch of the preset is no multiple of devices.
    """
    for name in ("batch_size", "small_batch_size"):
        if devices < 1 or getattr(module.preset, name) % devices:
            raise ValueError(f"devices={devices!r} must divide the preset's {name}={getattr(module.preset, name)}")
    # Channels-last must stay off while training: torch's CPU kernels for dilated grouped convolutions corrupt memory.
    last = output / "last.ckpt"
    if resume and last.is_file() and not zipfile.is_zipfile(last):
        raise ValueError(f"{last}: damaged or cut short; remove it to begin anew")
    keep = [
        ModelCheckpoint(output, filename="best", monitor="val/iou", mode="max", enable_version_counter=False),
        ModelCheckpoint(output, filename="last", save_top_k=1, monitor=None, enable_version_counter=False),
    ]
    trainer = L.Trainer(
        accelerator=accelerator,
        devices=devices,
        strategy="ddp" if devices > 1 else "auto",
        use_distributed_sampler=False,  # `FrameModule` gives each process its share
        precision=_usable_precision(module.preset.precision, accelerator),
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
    use_compiled_convolutions(module.network)
    with _flushed_denormals():
        trainer.fit(module, datamodule=frames, ckpt_path=str(last) if resume and last.is_file() else None)
    use_compiled_convolutions(module.network, False)
    use_merged_norms(module.network, False)
    module.network.eval()


def _usable_precision(precision: Precision, accelerator: str) -> Precision:
    """The preset's, or float32 on a processor without bfloat16 units, which takes ten times as long over bfloat16."""
    on_card = accelerator == "gpu" or (accelerator == "auto" and torch.cuda.is_available())
    if precision != "bf16-mixed" or on_card or torch.ops.mkldnn._is_mkldnn_bf16_supported():
        return precision
    LOGGER.warning("this processor has no bfloat16 units: training in float32")
    return "32-true"


@contextmanager
def _flushed_denormals() -> Iterator[None]:
    """Denormal activations of dying channels slow a CPU down many times; the mode is the whole process's."""
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)
