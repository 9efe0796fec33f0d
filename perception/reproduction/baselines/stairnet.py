"""StairNet, the monocular predecessor of StairNetV2, as the paper describes it, with its output on our grid.

What the paper says: focus module, SE-ResNeXt blocks with asymmetric dilated convolution (wider than high, as stair
lines are), one down-sampling less than StairNetV2, atrous spatial pyramid pooling, three classes, equation 1 with
lambda = alpha = 4, and about three times the size of StairNetV2. Where it is silent, the choice and its reason stand
beside the code. For the comparison of table 6 the output has StairNetV2's 32 x 16 cells with two lines each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from perception.data.label_grid import encode_grid
from perception.inference.backends import as_grids, check_batch
from perception.inference.batchnorm_fusion import folded
from perception.inference.preprocess import colour_input
from perception.inference.weights import DENSE_UP_TO_WIDTH
from perception.learning.losses import LOCATION_LOSSES, X_CHANNELS, Y_CHANNELS, LossWeights
from perception.network import (
    CARDINALITY,
    DEEP_STAGE_DILATIONS,
    NECK_CHANNELS,
    STAGE_1_DILATIONS,
    STEM_CHANNELS,
    Bottleneck,
    ConvNormAct,
    Focus,
    Head,
    start_blocks_as_shortcuts,
)
from stair_env.common.constants import GRID_COLUMNS, GRID_ROWS, NETWORK_WIDTHS
from stair_env.common.validation import check_choice

BACKGROUND, CONVEX_CELL, CONCAVE_CELL = 0, 1, 2  # classes of a cell
CLASSES = 3
STAGE_CHANNELS = (128, 256, 512)  # StairNetV2's, but 512 at last: with it, the size is three times StairNetV2's
ASPP_RATES = (6, 12, 18)  # of DeepLab v3 for features at an eighth of the image
ASPP_CHANNELS = 192  # the rest of that size
NECK_STRIDE = (2, 4)  # 64 x 64 features to 32 x 16 cells
WEIGHTS = LossWeights.fixed()  # equation 1, lambda = alpha = 4
LINE_PRIOR = 0.1  # start probability of the two line classes together, near the share of such cells


class StairNetOutput(NamedTuple):
    """What the loss needs.

    Attributes:
        kind_logits: (B, 3, 32, 16) background, convex, concave, before the softmax.
        loc: (B, 8, 32, 16) coordinates within the cell in 0..1, x1 y1 x2 y2 x3 y3 x4 y4.
    """

    kind_logits: Tensor
    loc: Tensor


class StairNetTargets(NamedTuple):
    """What a batch of labels holds.

    Attributes:
        kinds: (B, 32, 16) int64, 0 background, 1 convex, 2 concave.
        loc: (B, 8, 32, 16) float32 coordinates within the cell, 0 in empty cells.
    """

    kinds: Tensor
    loc: Tensor


class SpatialPyramid(nn.Module):
    """Atrous spatial pyramid pooling: 1 x 1, three dilated 3 x 3 and the image's mean side by side, mixed by 1 x 1.

    The mean's branch goes without batch norm: it has one value per image, which a batch of one cannot normalise.
    """

    def __init__(self, c_in: int, c_out: int) -> None:
        super().__init__()
        self.point = ConvNormAct(c_in, c_out)
        self.rings = nn.ModuleList(
            nn.Sequential(
                nn.Conv2d(c_in, c_out, 3, padding=rate, dilation=rate, bias=False),
                nn.BatchNorm2d(c_out),
                nn.ReLU(inplace=True),
            )
            for rate in ASPP_RATES
        )
        self.mean = nn.Sequential(nn.Conv2d(c_in, c_out, 1), nn.ReLU(inplace=True))
        self.mix = ConvNormAct((2 + len(ASPP_RATES)) * c_out, c_out)

    def forward(self, x: Tensor) -> Tensor:
        """(B, c_in, H, W) -> (B, c_out, H, W)."""
        mean = self.mean(x.mean((2, 3), keepdim=True)).expand(-1, -1, *x.shape[2:])
        return self.mix(torch.cat([self.point(x), *(ring(x) for ring in self.rings), mean], dim=1))


def _stage(c_in: int, c_out: int, groups: int, stride: int, dilations: tuple[int, ...]) -> nn.Sequential:
    """Bottlenecks whose convolutions are dilated along rows only, i.e. wider than high."""
    return nn.Sequential(
        *(
            Bottleneck(c_in if i == 0 else c_out, c_out, groups, stride=stride if i == 0 else 1, dilation=(1, d))
            for i, d in enumerate(dilations)
        )
    )


class StairNet(nn.Module):
    """The monocular detector.

    Args:
        width: channel width factor, 1.0, 0.5 or 0.25.

    Raises:
        ValueError: the width is none of these.
    """

    def __init__(self, width: float = 1.0) -> None:
        super().__init__()
        if width not in NETWORK_WIDTHS:
            raise ValueError(f"width={width!r} must be one of {', '.join(map(str, NETWORK_WIDTHS))}")
        self.width = float(width)
        stem, groups = int(STEM_CHANNELS * width), int(CARDINALITY * width)
        first, second, third = (int(channels * width) for channels in STAGE_CHANNELS)
        pyramid, neck = int(ASPP_CHANNELS * width), int(NECK_CHANNELS * width)
        self.features = nn.Sequential(
            Focus(3, stem),
            _stage(stem, first, groups, 2, STAGE_1_DILATIONS),
            _stage(first, second, groups, 2, DEEP_STAGE_DILATIONS),
            _stage(second, third, groups, 1, DEEP_STAGE_DILATIONS),
            SpatialPyramid(third, pyramid),
        )
        self.neck = ConvNormAct(pyramid, neck, kernel=3, stride=NECK_STRIDE)
        self.kind_head = Head(neck, CLASSES)
        self.loc_head = Head(neck, 8)
        self._initialise()

    def _initialise(self) -> None:
        """As StairNetV2 starts: blocks as their shortcuts, few lines expected, coordinates in the middle."""
        start_blocks_as_shortcuts(self)
        prior = torch.tensor([1.0 - LINE_PRIOR, LINE_PRIOR / 2, LINE_PRIOR / 2]).log()
        for head, bias in ((self.kind_head, prior), (self.loc_head, torch.zeros(8))):
            last = head[-1]
            assert isinstance(last, nn.Conv2d) and last.bias is not None
            nn.init.normal_(last.weight, std=0.01)
            with torch.no_grad():
                last.bias.copy_(bias)

    def forward_raw(self, rgb: Tensor) -> StairNetOutput:
        """What `forward` gives, with the three classes as logits, for training.

        Args:
            rgb: (B, 3, 512, 512) float32, scaled by `perception.inference.preprocess`.
        """
        features = self.neck(self.features(rgb))
        return StairNetOutput(self.kind_head(features), torch.sigmoid(self.loc_head(features)))

    def forward(self, rgb: Tensor) -> tuple[Tensor, Tensor]:
        """Detect, with StairNetV2's output.

        Args:
            rgb: (B, 3, 512, 512) float32. Any height and width divisible by 32 pass.

        Returns:
            cls: (B, 1, 32, 16) probability that the cell holds a line of either kind: convex and concave together.
            loc: (B, 8, 32, 16) coordinates within the cell in 0..1.
        """
        raw = self.forward_raw(rgb)
        background = torch.softmax(raw.kind_logits, dim=1)[:, BACKGROUND : BACKGROUND + 1]
        return 1.0 - background, raw.loc


class StairNetBackend:
    """StairNet as a `perception.inference.backends.Backend`, in the place of StairNetV2; depth is not looked at.

    It runs as `perception.inference.backends.TorchBackend` runs StairNetV2: batch norm folded, channels-last.

    Args:
        network: is copied.
    """

    def __init__(self, network: StairNet) -> None:
        plain = folded(network, dense=network.width <= DENSE_UP_TO_WIDTH)
        self._network = plain.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def __call__(self, rgb: np.ndarray, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Detect on a batch; see `perception.inference.backends.Backend`."""
        check_batch(rgb, depth_m)
        with torch.inference_mode():
            cls, loc = self._network(torch.from_numpy(colour_input(rgb)).to(memory_format=torch.channels_last))
        return as_grids(cls.numpy(), loc.numpy())


def encode_targets(
    lines: np.ndarray, kinds: np.ndarray, rows: int = GRID_ROWS, columns: int = GRID_COLUMNS
) -> StairNetTargets:
    """Targets of one image as a batch of one.

    Args:
        lines: (n, 4) pixels of the 512 x 512 image.
        kinds: (n,) 0 convex, 1 concave, as label files have them.
        rows, columns: size of the grid, for images smaller than 512 pixels; cells stay 32 x 16 pixels.

    Returns:
        Class and location of each cell. A cell with lines of both kinds has the class of its longest piece.

    Raises:
        ValueError: lines and kinds differ in number.
    """
    lines, kinds = np.asarray(lines, dtype=np.float64).reshape(-1, 4), np.asarray(kinds)
    if kinds.shape != (len(lines),):
        raise ValueError(f"kinds of shape {kinds.shape} must be one for each of {len(lines)} lines")
    longest = np.stack([_longest_piece(lines[kinds == kind], rows, columns) for kind in (0, 1)])
    cell = np.where(longest.max(axis=0) > 0.0, longest.argmax(axis=0) + 1, BACKGROUND)
    loc = np.moveaxis(encode_grid(lines, rows=rows, columns=columns).loc, -1, 0)
    return StairNetTargets(torch.from_numpy(cell)[None], torch.from_numpy(np.ascontiguousarray(loc))[None])


def _longest_piece(lines: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """(rows, columns) length of the longest piece in each cell, cell units, 0 in empty cells."""
    pieces = encode_grid(lines, rows=rows, columns=columns).loc.reshape(rows, columns, 2, 2, 2)
    return np.linalg.norm(pieces[..., 1, :] - pieces[..., 0, :], axis=-1).max(axis=-1)


def stairnet_loss(
    output: StairNetOutput, targets: StairNetTargets, location_loss: str = "l2", positive_weight: float = 1.0
) -> dict[str, Tensor]:
    """The unweighted terms of equation 1, each a mean over cells and images.

    Location errors are counted in cells that truly hold a line, as in `perception.learning.losses`, so that StairNet
    and StairNetV2 differ in network, classes and weights only.

    Args:
        output: of `StairNet.forward_raw`.
        targets: the batch's labels.
        location_loss: "l2" or "l1", see `perception.learning.losses.detection_loss`.
        positive_weight: factor on the class loss of cells that hold a line of either kind, see there.

    Returns:
        {"cls", "x", "y"}: scalars with gradient, for `perception.learning.losses.total_loss` with `WEIGHTS`.

    Raises:
        SpecError: location_loss is none of its choices (a ValueError).
    """
    check_choice("location_loss", location_loss, LOCATION_LOSSES)
    holds = (targets.kinds != BACKGROUND).to(output.loc.dtype)
    delta = output.loc - targets.loc
    error = holds[:, None] * (delta.square() if location_loss == "l2" else delta.abs())
    # Weighted cell by cell: with `weight=`, torch would divide by the sum of the weights.
    cls = F.cross_entropy(output.kind_logits, targets.kinds, reduction="none")
    return {
        "cls": (cls * (1.0 + (positive_weight - 1.0) * holds)).mean(),
        "x": error[:, X_CHANNELS].sum(1).mean(),
        "y": error[:, Y_CHANNELS].sum(1).mean(),
    }
