"""StairNetV2 (Wang et al., table 1 and figure 1): RGB and depth in, a 32 x 16 grid of stair-line segments out.

Where the paper is silent, the choice and its reason stand beside the code. The reading of table 1 below gives float32
state dicts of 10.4, 2.87 and 0.95 MB within 4 % for the three widths, which are the sizes that table 4 states.
"""

from __future__ import annotations

import io
from typing import NamedTuple

from stair_env.common.constants import FUSION_STAGES, NETWORK_WIDTHS
from stair_env.common.importing.extras import naming_extras

with naming_extras():
    import torch
    from torch import Tensor, nn
    from torch.nn import functional as F

STEM_CHANNELS = 32
STAGE_CHANNELS = (128, 256, 256)
CARDINALITY = 32  # groups of a ResNeXt bottleneck at width 1, as in ResNeXt's 32 x 4d
STAGE_1_DILATIONS = (1, 1, 1)
DEEP_STAGE_DILATIONS = (1, 2, 1, 4, 1, 8, 1, 16)  # bottlenecks 2.0-2.7, repeated as 3.0-3.7
NECK_CHANNELS = 128
SE_RATIO = 4  # the paper names no ratio; 4 is what makes the sizes of table 4 come out
CLS_PRIOR = 0.1  # start probability of "holds a line", near the share of such cells, so that training starts calm


class RawOutput(NamedTuple):
    """What the loss needs.

    Attributes:
        cls_logits: (B, 1, 32, 16) before the sigmoid.
        loc: (B, 8, 32, 16) coordinates within the cell in 0..1, x1 y1 x2 y2 x3 y3 x4 y4.
    """

    cls_logits: Tensor
    loc: Tensor


class GroupedConv3x3(nn.Module):
    """3 x 3 grouped convolution without bias, computed in one of three ways with the same results and gradients.

    torch's CPU kernels for a handful of channels per group are several times slower than one dense convolution over all
    channels, whose weight is zero between the groups (`dense`), and that three to five times slower than our own
    (`compiled`), which knows float32 on the processor and leaves all else to the others.

    Args:
        channels: in and out.
        groups: divides channels.
        stride: of both axes.
        dilation: of both axes, or (rows, columns); the padding keeps the size.
    """

    def __init__(self, channels: int, groups: int, stride: int = 1, dilation: int | tuple[int, int] = 1) -> None:
        super().__init__()
        if channels % groups:
            raise ValueError(f"groups={groups} must divide channels={channels}")
        self.channels, self.groups, self.stride, self.dilation = channels, groups, stride, dilation
        self.weight = nn.Parameter(torch.empty(channels, channels // groups, 3, 3))
        self.dense = self.compiled = False
        nn.init.kaiming_normal_(self.weight, mode="fan_out", nonlinearity="relu")

    def dense_weight(self, weight: Tensor) -> Tensor:
        """(channels, channels, 3, 3) block-diagonal form of a weight (channels, channels / groups, 3, 3)."""
        per_group = self.channels // self.groups
        blocks = weight.view(self.groups, per_group, 1, per_group, 3, 3)
        eye = torch.eye(self.groups, dtype=weight.dtype, device=weight.device)
        spread = blocks * eye.view(self.groups, 1, self.groups, 1, 1, 1)
        return spread.reshape(self.channels, self.channels, 3, 3)

    def convolve(self, x: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
        """What `forward` does, with another weight of the same shape and a bias (channels,)."""
        if (
            self.compiled
            and x.dtype == torch.float32
            and x.device.type == "cpu"
            and not torch.is_autocast_enabled("cpu")
        ):
            from perception.grouped_convolution import grouped_convolution

            rows, columns = (self.dilation,) * 2 if isinstance(self.dilation, int) else self.dilation
            return grouped_convolution(x, weight, bias, self.stride, (rows, columns))
        if self.dense:
            return F.conv2d(x, self.dense_weight(weight), bias, self.stride, self.dilation, self.dilation)
        return F.conv2d(x, weight, bias, self.stride, self.dilation, self.dilation, self.groups)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C, H / stride, W / stride)."""
        return self.convolve(x, self.weight)


def use_dense_convolutions(network: nn.Module, dense: bool = True) -> None:
    """Choose how the grouped convolutions of a network are computed (same results, see `GroupedConv3x3`)."""
    for module in network.modules():
        if isinstance(module, GroupedConv3x3):
            module.dense = dense


def use_compiled_convolutions(network: nn.Module, compiled: bool = True) -> None:
    """Choose whether our own kernels compute the grouped convolutions where they can, see `GroupedConv3x3`.

    They are for training: `perception.inference` has faster ways to run a network, and exporting one needs torch's own.
    """
    for module in network.modules():
        if isinstance(module, GroupedConv3x3):
            module.compiled = compiled


def _normed(norm: nn.Module, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Weight and bias of one convolution that does what a bias-free one and the batch norm after it do."""
    assert isinstance(norm, nn.BatchNorm2d) and norm.running_var is not None and norm.running_mean is not None
    scale = norm.weight * torch.rsqrt(norm.running_var + norm.eps)
    return weight * scale[:, None, None, None], norm.bias - norm.running_mean * scale


def _conv_norm(conv: nn.Conv2d | GroupedConv3x3, norm: nn.Module, x: Tensor) -> Tensor:
    """A convolution and its batch norm; as one convolution where `use_merged_norms` says so."""
    if norm.training or not getattr(norm, "merged", False):
        return norm(conv(x))
    if isinstance(conv, nn.Conv2d):
        weight, bias = _normed(norm, conv.weight)
        return F.conv2d(x, weight, bias, conv.stride, conv.padding, conv.dilation, conv.groups)
    return conv.convolve(x, *_normed(norm, conv.weight))


def use_merged_norms(network: nn.Module, merged: bool = True) -> None:
    """Compute batch norms whose statistics stand still within the convolutions before them.

    Gradients still reach the norms' factors and offsets. A training step on a CPU takes a sixth less time.
    """
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.merged = merged  # type: ignore[assignment]


class ConvNormAct(nn.Sequential):
    """Convolution, batch norm, ReLU."""

    def __init__(self, c_in: int, c_out: int, kernel: int = 1, stride: int | tuple[int, int] = 1) -> None:
        super().__init__(
            nn.Conv2d(c_in, c_out, kernel, stride, padding=kernel // 2, bias=False),
            nn.BatchNorm2d(c_out),
            nn.ReLU(inplace=True),
        )

    def forward(self, x: Tensor) -> Tensor:
        """(B, c_in, H, W) -> (B, c_out, H / stride, W / stride)."""
        return self[2](_conv_norm(self[0], self[1], x))  # type: ignore[arg-type]


class Focus(nn.Module):
    """YOLOv5's tensor slice: four interleaved quarter images as channels, mixed by a 1 x 1 convolution."""

    def __init__(self, c_in: int, c_out: int) -> None:
        super().__init__()
        self.mix = ConvNormAct(4 * c_in, c_out)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, c_out, H / 2, W / 2)."""
        return self.mix(F.pixel_unshuffle(x, 2))


class SqueezeExcite(nn.Module):
    """Channel gates from the mean of the feature map."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.squeeze = nn.Linear(channels, channels // SE_RATIO)
        self.excite = nn.Linear(channels // SE_RATIO, channels)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> the same, scaled per channel."""
        gate = torch.sigmoid(self.excite(F.relu(self.squeeze(x.mean((2, 3))))))
        return x * gate[:, :, None, None]


class Bottleneck(nn.Module):
    """SE-ResNeXt bottleneck: 1 x 1 to half, grouped 3 x 3 (stride and dilation here), 1 x 1 back, gates, shortcut."""

    def __init__(
        self, c_in: int, c_out: int, groups: int, stride: int = 1, dilation: int | tuple[int, int] = 1
    ) -> None:
        super().__init__()
        middle = c_out // 2
        self.reduce = ConvNormAct(c_in, middle)
        self.spatial = GroupedConv3x3(middle, groups, stride, dilation)
        self.spatial_norm = nn.BatchNorm2d(middle)
        self.expand = nn.Conv2d(middle, c_out, 1, bias=False)
        self.expand_norm = nn.BatchNorm2d(c_out)
        self.gates = SqueezeExcite(c_out)
        self.shortcut: nn.Module = nn.Identity()
        if stride != 1 or c_in != c_out:
            self.shortcut = nn.Sequential(nn.Conv2d(c_in, c_out, 1, stride, bias=False), nn.BatchNorm2d(c_out))

    def forward(self, x: Tensor) -> Tensor:
        """(B, c_in, H, W) -> (B, c_out, H / stride, W / stride)."""
        y = F.relu(_conv_norm(self.spatial, self.spatial_norm, self.reduce(x)))
        y = self.gates(_conv_norm(self.expand, self.expand_norm, y))
        if isinstance(self.shortcut, nn.Sequential):
            conv, norm = self.shortcut
            return F.relu(y + _conv_norm(conv, norm, x))  # type: ignore[arg-type]
        return F.relu(y + self.shortcut(x))


class SelectiveModule(nn.Module):
    """Figure 1: per channel, two weights that sum to 1 decide how much of RGB and of depth goes on.

    The figure goes from the pooled sum straight to two descriptors under a softmax. One vector cannot give two
    different ones without weights in between: one fully connected layer per branch is the least that can, and the
    softmax runs over the pair, so that the two descriptors restrict each other.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.select = nn.Linear(channels, 2 * channels)

    def pooled(self, rgb: Tensor, depth: Tensor) -> Tensor:
        """Two (B, C, H, W) -> (B, C): the mean over the image of their sum."""
        return (rgb + depth).mean((2, 3))

    def logits(self, rgb: Tensor, depth: Tensor) -> Tensor:
        """Two (B, C, H, W) -> (B, 2, C): what the softmax makes weights of, colour's first."""
        pair: Tensor = self.select(self.pooled(rgb, depth))
        return pair.view(pair.shape[0], 2, -1)

    def forward(self, rgb: Tensor, depth: Tensor) -> Tensor:
        """Two (B, C, H, W) -> (B, C, H, W)."""
        weights = torch.softmax(self.logits(rgb, depth), dim=1)[..., None, None]
        return rgb * weights[:, 0] + depth * weights[:, 1]


class Head(nn.Sequential):
    """3 x 3 convolution and 1 x 1 convolution to the output channels."""

    def __init__(self, channels: int, c_out: int) -> None:
        super().__init__(ConvNormAct(channels, channels, kernel=3), nn.Conv2d(channels, c_out, 1))


def start_blocks_as_shortcuts(network: nn.Module) -> None:
    """Initialise convolutions, and each bottleneck as its shortcut: 19 blocks then train at 1e-3 from the start."""
    for module in network.modules():
        if isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")
        if isinstance(module, Bottleneck):
            nn.init.zeros_(module.expand_norm.weight)


def _scaled(channels: int, width: float) -> int:
    return int(channels * width)


def _stage(index: int, c_in: int, width: float) -> nn.Sequential:
    """Bottlenecks of stage 1, 2 or 3; the first one halves the size."""
    c_out, groups = _scaled(STAGE_CHANNELS[index - 1], width), _scaled(CARDINALITY, width)
    dilations = STAGE_1_DILATIONS if index == 1 else DEEP_STAGE_DILATIONS
    blocks = [
        Bottleneck(c_in if i == 0 else c_out, c_out, groups, stride=2 if i == 0 else 1, dilation=d)
        for i, d in enumerate(dilations)
    ]
    return nn.Sequential(*blocks)


class StairNetV2(nn.Module):
    """The detector.

    Args:
        width: channel width factor, 1.0, 0.5 or 0.25.
        fusion_stage: number of down-samplings before the selective module: 2 (the paper's choice), 3 or 4.

    Raises:
        ValueError: an argument is none of its choices.
    """

    def __init__(self, width: float = 1.0, fusion_stage: int = 2) -> None:
        super().__init__()
        if width not in NETWORK_WIDTHS:
            raise ValueError(f"width={width!r} must be one of {', '.join(map(str, NETWORK_WIDTHS))}")
        if fusion_stage not in FUSION_STAGES:
            raise ValueError(f"fusion_stage={fusion_stage!r} must be one of {', '.join(map(str, FUSION_STAGES))}")
        self.width, self.fusion_stage = float(width), fusion_stage
        stem = _scaled(STEM_CHANNELS, width)
        stage_in = [stem, *(_scaled(c, width) for c in STAGE_CHANNELS[:-1])]
        own = range(1, fusion_stage)  # stages that each branch has for itself
        shared = range(fusion_stage, 4)
        self.rgb_branch = nn.Sequential(Focus(3, stem), *(_stage(i, stage_in[i - 1], width) for i in own))
        self.depth_branch = nn.Sequential(Focus(1, stem), *(_stage(i, stage_in[i - 1], width) for i in own))
        self.selective = SelectiveModule(_scaled(STAGE_CHANNELS[fusion_stage - 2], width))
        self.trunk = nn.Sequential(*(_stage(i, stage_in[i - 1], width) for i in shared))
        neck = _scaled(NECK_CHANNELS, width)
        self.neck = ConvNormAct(_scaled(STAGE_CHANNELS[-1], width), neck, kernel=3, stride=(1, 2))
        self.cls_head = Head(neck, 1)
        self.loc_head = Head(neck, 8)
        self._initialise()

    def _initialise(self) -> None:
        start_blocks_as_shortcuts(self)
        for head, bias in ((self.cls_head, torch.logit(torch.tensor(CLS_PRIOR)).item()), (self.loc_head, 0.0)):
            last = head[-1]
            assert isinstance(last, nn.Conv2d) and last.bias is not None
            nn.init.normal_(last.weight, std=0.01)
            nn.init.constant_(last.bias, bias)

    def use_dense_convolutions(self, dense: bool = True) -> StairNetV2:
        """Choose how grouped convolutions are computed (same results, see `GroupedConv3x3`); returns self."""
        use_dense_convolutions(self, dense)
        return self

    def forward_raw(self, rgb: Tensor, depth: Tensor) -> RawOutput:
        """What `forward` gives, with classification as logits, for training.

        Args:
            rgb: (B, 3, 512, 512) float32, scaled by `perception.inference.preprocess`.
            depth: (B, 1, 512, 512) float32, likewise.
        """
        return self.detect(self.rgb_branch(rgb), self.depth_branch(depth))

    def detect(self, rgb_features: Tensor, depth_features: Tensor) -> RawOutput:
        """What comes after the two branches.

        Args:
            rgb_features: (B, C, H, W), what `rgb_branch` makes of colour.
            depth_features: the same of depth.
        """
        features = self.neck(self.trunk(self.selective(rgb_features, depth_features)))
        return RawOutput(self.cls_head(features), torch.sigmoid(self.loc_head(features)))

    def forward(self, rgb: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
        """Detect.

        Any height and width divisible by 32 pass; the grid is then (H / 16, W / 32).

        Args:
            rgb: (B, 3, 512, 512) float32.
            depth: (B, 1, 512, 512) float32.

        Returns:
            cls: (B, 1, 32, 16) probability that the cell holds a stair line, in 0..1 (threshold 0.5). Table 1 draws the
                sigmoid in the location column only; here both are activated, so that 0.5 means what equation 10 says.
            loc: (B, 8, 32, 16) coordinates within the cell in 0..1: x1 y1 x2 y2 of one line, x3 y3 x4 y4 of the other.
        """
        raw = self.forward_raw(rgb, depth)
        return torch.sigmoid(raw.cls_logits), raw.loc


def state_dict_megabytes(network: nn.Module) -> float:
    """Size of the state dict as `torch.save` writes it, 10^6 bytes: what table 4 counts.

    The three published sizes only fit a network whose parameters grow with the square of the width if about 0.2 MB
    do not depend on the width at all. That is the file's own book-keeping, a third of a kilobyte per tensor.
    """
    buffer = io.BytesIO()
    torch.save(network.state_dict(), buffer)
    return buffer.tell() / 1e6
