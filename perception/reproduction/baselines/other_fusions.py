"""Two other ways to bring colour and depth together, of those that the paper's related work names, as ablations.

Everything else is StairNetV2 (table 1), so that a difference is the fusion's: the four channels as one image, and the
two branches' features side by side. The first has one branch less to compute, the second as much as StairNetV2.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from perception.network import (
    STAGE_CHANNELS,
    STEM_CHANNELS,
    ConvNormAct,
    Focus,
    RawOutput,
    StairNetV2,
    start_blocks_as_shortcuts,
)


class Concatenation(nn.Module):
    """Features of both branches side by side, mixed back to the channels of one by a 1 x 1 convolution."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.mix = ConvNormAct(2 * channels, channels)

    def forward(self, rgb: Tensor, depth: Tensor) -> Tensor:
        """Two (B, C, H, W) -> (B, C, H, W)."""
        mixed: Tensor = self.mix(torch.cat([rgb, depth], dim=1))
        return mixed


class ConcatenatingStairNet(StairNetV2):
    """StairNetV2 with a concatenation in the selective module's place.

    Args:
        width: channel width factor, 1.0, 0.5 or 0.25.
    """

    def __init__(self, width: float = 1.0) -> None:
        super().__init__(width)
        self.selective = Concatenation(int(STAGE_CHANNELS[0] * width))  # type: ignore[assignment]
        start_blocks_as_shortcuts(self.selective)


class FourChannelStairNet(StairNetV2):
    """StairNetV2 with one branch for an image of four channels: colour and depth.

    Args:
        width: channel width factor, 1.0, 0.5 or 0.25.
    """

    def __init__(self, width: float = 1.0) -> None:
        super().__init__(width)
        stage = self.rgb_branch[1]
        self.rgb_branch = nn.Sequential(Focus(4, int(STEM_CHANNELS * width)), stage)
        start_blocks_as_shortcuts(self.rgb_branch)
        del self.depth_branch, self.selective

    def forward_raw(self, rgb: Tensor, depth: Tensor) -> RawOutput:
        """As StairNetV2's."""
        features = self.neck(self.trunk(self.rgb_branch(torch.cat([rgb, depth], dim=1))))
        return RawOutput(self.cls_head(features), torch.sigmoid(self.loc_head(features)))
