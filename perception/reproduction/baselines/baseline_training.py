"""Training of the paper's opponents: the presets, frames and trainer of StairNetV2, around their own losses."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from perception.data.stair_dataset import Sample
from perception.inference.preprocess import colour_input
from perception.learning.frames import Batch
from perception.learning.losses import total_loss
from perception.learning.metrics import DetectionCounts, count_cells
from perception.learning.network_training import DetectorTraining
from perception.learning.presets import TrainingPreset
from perception.network import use_dense_convolutions
from perception.reproduction.baselines.region_detector import region_of
from perception.reproduction.baselines.region_loss import Regions, complete_iou, roi_loss
from perception.reproduction.baselines.region_network import RoiNetwork
from perception.reproduction.baselines.stairnet import (
    WEIGHTS,
    StairNet,
    StairNetOutput,
    StairNetTargets,
    encode_targets,
    stairnet_loss,
)

REGION_SCORE = 0.25  # least score that counts while validating, YOLOv5's own for showing a box


def stairnet_arrays(sample: Sample) -> tuple[np.ndarray, ...]:
    """Input and targets of StairNet: rgb float32 (3, H, W), kinds int64 and loc float32 (8, H / 16, W / 32)."""
    height, width = sample.depth_m.shape
    targets = encode_targets(sample.lines, sample.kinds, height // 16, width // 32)
    return colour_input(sample.rgb[None])[0], targets.kinds[0].numpy(), targets.loc[0].numpy()


class MonocularTraining(DetectorTraining):
    """StairNet with equation 1: fixed weights, whatever the preset says of dynamic ones.

    Args:
        width: of the network.
        preset: how to train.
    """

    network: StairNet

    def __init__(self, width: float, preset: TrainingPreset) -> None:
        network = StairNet(width)
        use_dense_convolutions(network, not torch.cuda.is_available())
        super().__init__(network, preset)
        self._counts = DetectionCounts()

    def training_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Equation 1 over a batch."""
        rgb, kinds, loc = batch
        raw = self.network.forward_raw(rgb)
        raw = StairNetOutput(raw.kind_logits.float(), raw.loc.float())
        preset = self.preset
        terms = stairnet_loss(raw, StairNetTargets(kinds, loc), preset.location_loss, preset.positive_weight)
        loss = total_loss(terms, WEIGHTS)
        self.log_dict({f"loss/{name}": term.detach() for name, term in terms.items()})
        self.log("loss/total", loss.detach(), prog_bar=True)
        return loss

    def on_validation_epoch_start(self) -> None:
        """Count from zero."""
        self._counts = DetectionCounts()

    def validation_step(self, batch: Batch, batch_index: int) -> None:
        """Equation 10 over a batch."""
        rgb, kinds, loc = batch
        score, place = (output.float() for output in self.network(rgb))
        predicted, true = (x.movedim(1, -1).cpu().numpy() for x in (place, loc))
        holds = (kinds > 0).cpu().numpy().astype(np.float32)
        self._counts += count_cells(score[:, 0].cpu().numpy(), predicted, holds, true)

    def on_validation_epoch_end(self) -> None:
        """Log the metrics."""
        counts = self._counts
        self.log_dict({"val/accuracy": counts.accuracy, "val/recall": counts.recall})
        self.log("val/iou", counts.iou, prog_bar=True)


def roi_arrays(sample: Sample) -> tuple[np.ndarray, ...]:
    """Input and target of the region detector: rgb float32 (3, H, W), whether there are stairs (), their box (4,)."""
    box = region_of(sample.lines, sample.depth_m.shape[0])
    there = box is not None
    centred = np.zeros(4) if box is None else np.concatenate([(box[:2] + box[2:]) / 2.0, box[2:] - box[:2]])
    fractions = (centred / sample.depth_m.shape[0]).astype(np.float32)
    return colour_input(sample.rgb[None])[0], np.array(there), fractions


class RoiTraining(DetectorTraining):
    """The region detector with its own loss; colour only, as in the paper.

    Args:
        width: of the network.
        preset: how to train; its location loss and weights are for line detectors and not used.
    """

    network: RoiNetwork

    def __init__(self, width: float, preset: TrainingPreset) -> None:
        super().__init__(RoiNetwork(width), preset)
        self._overlaps: list[float] = []
        self._found_in_vain: list[bool] = []

    def training_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Box and score terms over a batch."""
        rgb, there, boxes = batch
        raw = [grid.float() for grid in self.network.forward_raw(rgb)]
        terms = roi_loss(raw, Regions(there, boxes), self.network.anchors)
        loss = terms["box"] + terms["score"]
        self.log_dict({f"loss/{name}": term.detach() for name, term in terms.items()})
        self.log("loss/total", loss.detach(), prog_bar=True)
        return loss

    def on_validation_epoch_start(self) -> None:
        """Forget the last epoch's."""
        self._overlaps, self._found_in_vain = [], []

    def validation_step(self, batch: Batch, batch_index: int) -> None:
        """The best box of each frame against the truth."""
        rgb, there, boxes = batch
        found = self.network(rgb).float()
        best = found[torch.arange(len(found)), found[..., 4].argmax(dim=1)]
        scored = best[:, 4] >= REGION_SCORE
        overlap = complete_iou(best[:, :4], boxes).clamp(min=0.0) * scored
        self._overlaps += overlap[there].tolist()
        self._found_in_vain += scored[~there].tolist()

    def on_validation_epoch_end(self) -> None:
        """Log the mean overlap of boxes with the truth, none counting 0, and how often stairs are found in vain."""
        self.log("val/iou", 100.0 * float(np.mean(self._overlaps or [0.0])), prog_bar=True)
        self.log("val/found_in_vain", 100.0 * float(np.mean(self._found_in_vain or [False])))
