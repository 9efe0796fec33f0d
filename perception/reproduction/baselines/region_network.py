"""A one-class region detector in YOLOv5's architecture, nano size, written from its published description.

What is YOLOv5's: a backbone of strided convolutions and CSP blocks ("C3") that ends in fast spatial pyramid pooling, a
feature pyramid with a path down and a path up again (PAN), three anchor boxes at each of the strides 8, 16 and 32, and
boxes decoded from sigmoids that reach half a cell beyond their own. The class score is left out: with one class,
objectness is the score. Boxes are fractions of the image's side, so that frames at half size teach the same boxes.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from stair_env.common.constants import IMAGE_SIZE

STRIDES = (8, 16, 32)
ANCHORS_PER_CELL = 3
VALUES = 5  # x, y, width, height, objectness
# Width and height in pixels of the 512 x 512 image: k-means (distance 1 - IOU, medians) over the boxes of 3000 training
# frames, sorted by area and dealt out to the strides, as YOLOv5 does with its own set. Stairs are wide and near.
ANCHORS_PX = (
    ((308, 17), (248, 68), (453, 42)),
    ((467, 89), (310, 141), (512, 159)),
    ((347, 260), (512, 233), (512, 332)),
)
CHANNELS = (64, 128, 256, 512, 1024)  # at width 1; stem and the four stages
BACKBONE_REPEATS = (3, 6, 9, 3)  # bottlenecks in each stage's CSP block, at depth 1
NECK_REPEATS = 3
DEPTH = 0.33  # YOLOv5's depth multiple of its small and nano sizes
REGION_WIDTHS = (1.0, 0.5, 0.25)  # the large, small and nano widths
POOL = 5  # pixels, of the pyramid pooling
NORM_EPS, NORM_MOMENTUM = 1e-3, 0.03
FOUND_PER_IMAGE = 1.0  # objects an image is expected to hold, for the first objectness


class ConvNormSilu(nn.Sequential):
    """Convolution, batch norm, SiLU."""

    def __init__(self, c_in: int, c_out: int, kernel: int = 1, stride: int = 1, padding: int | None = None) -> None:
        super().__init__(
            nn.Conv2d(c_in, c_out, kernel, stride, kernel // 2 if padding is None else padding, bias=False),
            nn.BatchNorm2d(c_out, NORM_EPS, NORM_MOMENTUM),
            nn.SiLU(inplace=True),
        )


class Residual(nn.Module):
    """1 x 1 and 3 x 3 convolution, with or without a shortcut around both."""

    def __init__(self, channels: int, shortcut: bool) -> None:
        super().__init__()
        self.body = nn.Sequential(ConvNormSilu(channels, channels), ConvNormSilu(channels, channels, 3))
        self.shortcut = shortcut

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> the same."""
        return x + self.body(x) if self.shortcut else self.body(x)


class CspBlock(nn.Module):
    """Cross-stage partial block: half of the channels pass the bottlenecks, half go around them."""

    def __init__(self, c_in: int, c_out: int, repeats: int, shortcut: bool = True) -> None:
        super().__init__()
        half = c_out // 2
        self.through = nn.Sequential(ConvNormSilu(c_in, half), *(Residual(half, shortcut) for _ in range(repeats)))
        self.around = ConvNormSilu(c_in, half)
        self.mix = ConvNormSilu(2 * half, c_out)

    def forward(self, x: Tensor) -> Tensor:
        """(B, c_in, H, W) -> (B, c_out, H, W)."""
        return self.mix(torch.cat([self.through(x), self.around(x)], dim=1))


class FastPyramidPool(nn.Module):
    """The features beside their maxima over 5, 9 and 13 pixels, by pooling the pooled."""

    def __init__(self, c_in: int, c_out: int) -> None:
        super().__init__()
        self.reduce = ConvNormSilu(c_in, c_in // 2)
        self.mix = ConvNormSilu(2 * c_in, c_out)

    def forward(self, x: Tensor) -> Tensor:
        """(B, c_in, H, W) -> (B, c_out, H, W)."""
        maps = [self.reduce(x)]
        for _ in range(3):
            maps.append(F.max_pool2d(maps[-1], POOL, stride=1, padding=POOL // 2))
        return self.mix(torch.cat(maps, dim=1))


class PathAggregation(nn.Module):
    """The neck: coarse features go up to the fine ones, and what comes out goes down again."""

    def __init__(self, channels: tuple[int, int, int], repeats: int) -> None:
        super().__init__()
        fine, middle, coarse = channels
        self.narrow_coarse = ConvNormSilu(coarse, middle)
        self.up_middle = CspBlock(2 * middle, middle, repeats, shortcut=False)
        self.narrow_middle = ConvNormSilu(middle, fine)
        self.up_fine = CspBlock(2 * fine, fine, repeats, shortcut=False)
        self.shrink_fine = ConvNormSilu(fine, fine, 3, 2)
        self.down_middle = CspBlock(2 * fine, middle, repeats, shortcut=False)
        self.shrink_middle = ConvNormSilu(middle, middle, 3, 2)
        self.down_coarse = CspBlock(2 * middle, coarse, repeats, shortcut=False)

    def forward(self, fine: Tensor, middle: Tensor, coarse: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Features at strides 8, 16 and 32 -> the same shapes."""
        top = self.narrow_coarse(coarse)
        side = self.narrow_middle(self.up_middle(torch.cat([F.interpolate(top, scale_factor=2.0), middle], dim=1)))
        fine = self.up_fine(torch.cat([F.interpolate(side, scale_factor=2.0), fine], dim=1))
        middle = self.down_middle(torch.cat([self.shrink_fine(fine), side], dim=1))
        coarse = self.down_coarse(torch.cat([self.shrink_middle(middle), top], dim=1))
        return fine, middle, coarse


class RoiNetwork(nn.Module):
    """The region detector.

    Args:
        width: channel width factor: 1.0 (YOLOv5l), 0.5 (s) or 0.25 (n).

    Raises:
        ValueError: the width is none of these.
    """

    def __init__(self, width: float = 0.25) -> None:
        super().__init__()
        if width not in REGION_WIDTHS:
            raise ValueError(f"width={width!r} must be one of {', '.join(map(str, REGION_WIDTHS))}")
        self.width = float(width)
        stem, first, fine, middle, coarse = (int(channels * width) for channels in CHANNELS)
        repeats = [max(round(count * DEPTH), 1) for count in BACKBONE_REPEATS]
        self.early = nn.Sequential(
            ConvNormSilu(3, stem, 6, 2, padding=2),
            ConvNormSilu(stem, first, 3, 2),
            CspBlock(first, first, repeats[0]),
            ConvNormSilu(first, fine, 3, 2),
            CspBlock(fine, fine, repeats[1]),
        )
        self.middle = nn.Sequential(ConvNormSilu(fine, middle, 3, 2), CspBlock(middle, middle, repeats[2]))
        self.coarse = nn.Sequential(
            ConvNormSilu(middle, coarse, 3, 2), CspBlock(coarse, coarse, repeats[3]), FastPyramidPool(coarse, coarse)
        )
        self.neck = PathAggregation((fine, middle, coarse), max(round(NECK_REPEATS * DEPTH), 1))
        self.heads = nn.ModuleList(nn.Conv2d(c, ANCHORS_PER_CELL * VALUES, 1) for c in (fine, middle, coarse))
        self.register_buffer("anchors", torch.tensor(ANCHORS_PX) / IMAGE_SIZE, persistent=False)
        self.anchors: Tensor
        self._expect_few_objects()

    def _expect_few_objects(self) -> None:
        """Start with the objectness of one object an image, so that empty cells do not drown the first steps."""
        for head, stride in zip(self.heads, STRIDES):
            assert isinstance(head, nn.Conv2d) and head.bias is not None
            bias = math.log(FOUND_PER_IMAGE / (IMAGE_SIZE / stride) ** 2)
            with torch.no_grad():
                head.bias.view(ANCHORS_PER_CELL, VALUES)[:, 4] = bias

    def forward_raw(self, rgb: Tensor) -> list[Tensor]:
        """What the loss needs: per stride (B, 3 anchors, rows, columns, 5), before the sigmoid."""
        fine = self.early(rgb)
        middle = self.middle(fine)
        maps = self.neck(fine, middle, self.coarse(middle))
        grids = []
        for head, features in zip(self.heads, maps):
            raw = head(features)
            grids.append(raw.view(raw.shape[0], ANCHORS_PER_CELL, VALUES, *raw.shape[2:]).permute(0, 1, 3, 4, 2))
        return grids

    def forward(self, rgb: Tensor) -> Tensor:
        """Detect.

        Args:
            rgb: (B, 3, H, W) float32, scaled by `perception.inference.preprocess`; H = W, a multiple of 32.

        Returns:
            (B, n, 5): centre x, centre y, width, height in fractions of the image's side, and the score in 0..1.
        """
        found = []
        for raw, anchors in zip(self.forward_raw(rgb), self.anchors):
            boxes = decode_boxes(raw.float(), anchors)
            found.append(torch.cat([boxes, torch.sigmoid(raw.float()[..., 4:])], dim=-1).flatten(1, 3))
        return torch.cat(found, dim=1)


def cell_corners(rows: int, columns: int, device: torch.device | None = None) -> Tensor:
    """(rows, columns, 2) x and y of each cell's upper left corner, in cells."""
    y, x = torch.meshgrid(torch.arange(rows, device=device), torch.arange(columns, device=device), indexing="ij")
    return torch.stack([x, y], dim=-1).float()


def decode_boxes(raw: Tensor, anchors: Tensor) -> Tensor:
    """Boxes of one stride: the centre from half a cell before to half a cell behind its own, sizes 0 to 4 anchors.

    Args:
        raw: (B, 3, rows, columns, >= 4) before the sigmoid.
        anchors: (3, 2) width and height in fractions of the image's side.

    Returns:
        (B, 3, rows, columns, 4) centre x, centre y, width, height, fractions of the image's side.
    """
    rows, columns = raw.shape[2:4]
    place = torch.sigmoid(raw[..., :4])
    cells = torch.tensor([columns, rows], dtype=place.dtype, device=place.device)
    centre = (2.0 * place[..., :2] - 0.5 + cell_corners(rows, columns, raw.device)) / cells
    size = (2.0 * place[..., 2:]) ** 2 * anchors[:, None, None]
    return torch.cat([centre, size], dim=-1)
