"""The detector's loss with fixed or dynamic weights (paper, equations 1 to 6).

Losses come back by name; `LossWeights` says how they add up. Location errors count only in cells that truly hold a
line. Equations 1 and 2 write the predicted p there, but that would reward a network for doubting a cell that it
cannot locate; equations 3 and 4 have the truth p*, and so does this module.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from perception.network import RawOutput
from stair_env.common.field_kinds import naming_fields

X_CHANNELS = (0, 2, 4, 6)  # of the location output: x1 y1 x2 y2 x3 y3 x4 y4
Y_CHANNELS = (1, 3, 5, 7)
INITIAL_DYNAMIC_WEIGHT = 10.0  # alpha and beta at the start (paper, below equation 2)
MIN_DYNAMIC_WEIGHT = 0.5  # sigma (paper, above equation 5)
STAIRNET_LAMBDA = 4.0  # lambda and alpha of equation 1 (paper, below equation 1)
STAIRNET_ALPHA = 4.0
LOCATION_LOSSES = ("l1", "l2")


class GridTargets(NamedTuple):
    """What a batch of label grids holds.

    Attributes:
        cls: (B, 1, 32, 16) float32, 1 where the cell holds a line.
        loc: (B, 8, 32, 16) float32 coordinates within the cell, 0 in empty cells.
    """

    cls: Tensor
    loc: Tensor


@dataclass(frozen=True)
class LossWeights:
    """Factors of the x and y location losses beside the classification loss (equation 2).

    Args:
        x, y: alpha and beta, non-negative.

    Raises:
        ValueError: a weight is negative or not finite.
    """

    x: float = INITIAL_DYNAMIC_WEIGHT
    y: float = INITIAL_DYNAMIC_WEIGHT

    @naming_fields
    def __post_init__(self) -> None:
        for name in ("x", "y"):
            value = getattr(self, name)
            if not 0.0 <= value < float("inf"):
                raise ValueError(f"{name}={value!r} must be a finite number >= 0")

    @classmethod
    def fixed(cls, balance: float = STAIRNET_LAMBDA, alpha: float = STAIRNET_ALPHA) -> LossWeights:
        """Equation 1: lambda (x + alpha y) in the terms of equation 2."""
        return cls(balance, balance * alpha)

    def updated(self, x_error: float, y_error: float) -> LossWeights:
        """Equations 5 and 6: shift weight towards the axis with the larger error on the validation set.

        Args:
            x_error, y_error: equations 3 and 4, from `location_errors`.

        Returns:
            New weights. When a new weight would lie below 0.5, or when both errors are 0, the old ones stay: the paper
            leaves both unadjusted, which keeps their sum.
        """
        largest = max(x_error, y_error)
        if largest <= 0.0:
            return self
        shift = (x_error - y_error) / largest
        x, y = self.x + shift, self.y - shift
        return self if min(x, y) < MIN_DYNAMIC_WEIGHT else LossWeights(x, y)


def detection_loss(
    raw: RawOutput, targets: GridTargets, location_loss: str = "l2", positive_weight: float = 1.0
) -> dict[str, Tensor]:
    """The unweighted terms of equation 2, each a mean over cells and images.

    Args:
        raw: the network's output for a batch.
        targets: the batch's label grids.
        location_loss: "l2" (squared, summed over the four coordinates of an axis) or "l1". The paper leaves L_loc open.
        positive_weight: factor on the class loss of cells that hold a line. Scores are cut at 0.5, but the IOU of a
            network of IOU J is largest when cells are scored from a probability of J / (1 + J) on; a weight w moves
            the cut to 1 / (1 + w).

    Returns:
        {"cls", "x", "y"}: scalars with gradient.

    Raises:
        ValueError: location_loss is none of its choices.
    """
    terms = frame_losses(raw, targets, location_loss, positive_weight)
    return {name: term.mean() for name, term in terms.items()}


def frame_losses(
    raw: RawOutput, targets: GridTargets, location_loss: str = "l2", positive_weight: float = 1.0
) -> dict[str, Tensor]:
    """The terms of `detection_loss` for each frame, (B,)."""
    if location_loss not in LOCATION_LOSSES:
        raise ValueError(f"location_loss={location_loss!r} must be one of {', '.join(LOCATION_LOSSES)}")
    weight = torch.tensor(positive_weight, dtype=raw.cls_logits.dtype, device=raw.cls_logits.device)
    cls = F.binary_cross_entropy_with_logits(raw.cls_logits, targets.cls, pos_weight=weight, reduction="none")
    delta = raw.loc - targets.loc
    error = delta.square() if location_loss == "l2" else delta.abs()
    return {
        "cls": cls.mean((1, 2, 3)),
        "x": (targets.cls * error[:, X_CHANNELS]).sum(1).mean((1, 2)),
        "y": (targets.cls * error[:, Y_CHANNELS]).sum(1).mean((1, 2)),
    }


def total_loss(terms: dict[str, Tensor], weights: LossWeights) -> Tensor:
    """Equation 2."""
    return terms["cls"] + weights.x * terms["x"] + weights.y * terms["y"]


@torch.no_grad()
def location_errors(loc: Tensor, targets: GridTargets) -> tuple[float, float]:
    """Equations 3 and 4 over a batch: total L1 error of x and of y in the cells that hold a line.

    Args:
        loc: (B, 8, 32, 16) prediction.
        targets: the truth.
    """
    error = targets.cls * (loc - targets.loc).abs()
    return float(error[:, X_CHANNELS].sum()), float(error[:, Y_CHANNELS].sum())
