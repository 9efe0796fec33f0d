"""Which modality tells more of a frame, as a target for the selective module.

The paper lets the detection loss alone teach the module. What that loss needs is no more than branches whose features
die where their modality says nothing, and so the module hardly moves (docs/stairnetv2.md). Here it is told: the network
itself is asked how well it does by either modality alone, and colour's weight is to rise with depth's share of
the loss.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from perception.learning.losses import GridTargets, LossWeights, frame_losses, total_loss
from perception.network import SelectiveModule, StairNetV2

MOST_SHARE = 0.98  # that is ever asked for
RIDGE_FRAMES = 5.0  # weight of the ridge against the frames seen, features at unit variance
FIT_FRAMES = 600  # that the start of the selective module's layer is fitted to
SHARPNESS = 2.0  # power of the losses: at twice the loss a modality is to have a fifth of the weight


@torch.no_grad()
def colour_share(
    network: StairNetV2,
    rgb_features: Tensor,
    depth_features: Tensor,
    targets: GridTargets,
    weights: LossWeights,
    location_loss: str = "l2",
    positive_weight: float = 1.0,
) -> Tensor:
    """How much of a frame is to be read from colour, by how well either modality does alone.

    Args:
        network: which is asked.
        rgb_features: (B, C, H, W), what `network.rgb_branch` makes of colour.
        depth_features: the same of depth.
        targets: the truth.
        weights: of the location losses.
        location_loss: see `perception.learning.losses.detection_loss`.
        positive_weight: see `perception.learning.losses.detection_loss`.

    Returns:
        (B,) float32 in 0..1: the loss by depth alone to the power of `SHARPNESS`, as a share of both.
    """
    height, width = (size * 2**network.fusion_stage for size in rgb_features.shape[2:])
    nothing = torch.full((1, 3, height, width), -1.0, device=rgb_features.device)  # black, and no reading
    black, blind = network.rgb_branch(nothing), network.depth_branch(nothing[:, :1])
    losses = []
    for pair in ((rgb_features, blind.expand_as(depth_features)), (black.expand_as(rgb_features), depth_features)):
        raw = network.detect(*pair)
        raw = type(raw)(raw.cls_logits.float(), raw.loc.float())
        losses.append(total_loss(frame_losses(raw, targets, location_loss, positive_weight), weights))
    by_colour, by_depth = (loss.clamp_min(1e-6) ** SHARPNESS for loss in losses)
    return by_depth / (by_colour + by_depth)


def trust_loss(logits: Tensor, share: Tensor) -> Tensor:
    """How far the module's weights differ between frames otherwise than `colour_share` asks for.

    Compared are differences from the batch's mean: what each channel takes of colour on average is the detection loss's
    affair. Drawing the average itself to the share costs a trunk that is used to another (docs/stairnetv2.md).

    Args:
        logits: (B, 2, C) of `perception.network.SelectiveModule.logits`.
        share: (B,) colour's.

    Returns:
        Smooth L1 loss between log odds, a mean over channels and frames; 0 for a single frame.
    """
    colour, wanted = (logits[:, 0] - logits[:, 1]).float(), log_odds(share)
    wanted = wanted - wanted.mean()
    return F.smooth_l1_loss(colour - colour.mean(0, keepdim=True), wanted[:, None].expand_as(colour))


def log_odds(share: Tensor) -> Tensor:
    """(B,) log odds of a share, none of them certain."""
    return torch.logit(share.clamp(1.0 - MOST_SHARE, MOST_SHARE))


class SelectionFit:
    """The linear layer of the selective module that follows `colour_share` as well as a linear one can.

    A layer that starts near zero has a long way to go at the rate that suits the other layers: fitted by least squares
    to a few hundred frames it is there at once, and training goes on from it.

    Attributes:
        moments: (C + 2, C + 2) float64, sums over frames of the products of 1, the C pooled features, and log odds.
    """

    def __init__(self, channels: int) -> None:
        self.moments = np.zeros((channels + 2, channels + 2))

    def add(self, pooled: Tensor, share: Tensor) -> None:
        """Take frames in.

        Args:
            pooled: (B, C) of `perception.network.SelectiveModule.pooled`.
            share: (B,) of `colour_share`.
        """
        columns = torch.cat([torch.ones_like(pooled[:, :1]), pooled, log_odds(share)[:, None]], dim=1)
        rows = columns.detach().double().cpu().numpy()
        self.moments += rows.T @ rows

    def apply(self, module: SelectiveModule) -> float:
        """Add the fit to every channel's weights; their mean over the frames seen stays as it is.

        Args:
            module: changed in place.

        Returns:
            Share of the variance of the log odds that the fit explains, on the frames that were seen.
        """
        count = self.moments[0, 0]
        mean = self.moments[0, 1:] / count
        covariance = self.moments[1:, 1:] / count - np.outer(mean, mean)
        among, towards, total = covariance[:-1, :-1], covariance[:-1, -1], covariance[-1, -1]
        ridge = np.diag(np.diag(among) * RIDGE_FRAMES / count + 1e-12)
        slope = np.linalg.solve(among + ridge, towards)
        change = torch.as_tensor(slope / 2.0, dtype=module.select.weight.dtype, device=module.select.weight.device)
        offset = float(slope @ mean[:-1]) / 2.0
        channels = len(slope)
        with torch.no_grad():
            for half, sign in ((slice(0, channels), 1.0), (slice(channels, None), -1.0)):
                module.select.weight[half] += sign * change
                module.select.bias[half] -= sign * offset
        return float((2.0 * slope @ towards - slope @ among @ slope) / total) if total > 0.0 else 0.0
