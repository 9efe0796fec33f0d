"""Which anchors answer for a region, and the loss of the region detector, as YOLOv5's description has them."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from perception.reproduction.baselines.region_network import cell_corners, decode_boxes

MAX_RATIO = 4.0  # between the sides of a region and of an anchor that answers for it
REACH = 0.5  # cells beyond a centre's own that answer too: those whose half faces the centre
BALANCE = (4.0, 1.0, 0.4)  # of objectness at strides 8, 16 and 32: fine grids have more cells, mostly empty ones
# Of the two terms. YOLOv5's 1 for the score is for COCO with its seven objects a picture; here there is at most one.
BOX_GAIN, SCORE_GAIN = 0.05, 7.0
TINY = 1e-7


class Regions(NamedTuple):
    """At most one region an image.

    Attributes:
        there: (B,) bool.
        boxes: (B, 4) centre x, centre y, width, height in fractions of the image's side; any value without region.
    """

    there: Tensor
    boxes: Tensor


def answering_cells(regions: Regions, anchors: Tensor, rows: int, columns: int) -> Tensor:
    """Which anchors of one stride are to find the regions.

    Args:
        regions: of a batch.
        anchors: (3, 2) fractions of the image's side.
        rows, columns: cells of the stride's grid.

    Returns:
        (B, 3, rows, columns) bool: the sides of anchor and region differ at most fourfold, and the region's centre lies
        in the cell or within half a cell of it along one axis.
    """
    centre, size = regions.boxes[:, :2], regions.boxes[:, 2:].clamp(min=TINY)
    ratio = size[:, None] / anchors
    fits = torch.maximum(ratio, 1.0 / ratio).amax(dim=-1) < MAX_RATIO  # (B, 3)
    cells = torch.tensor([columns, rows], dtype=centre.dtype, device=centre.device)
    corner = cell_corners(rows, columns, centre.device)
    offset = (centre * cells).clamp(min=0.0)[:, None, None] - corner - 0.5  # (B, rows, columns, 2), 0 in the middle
    far, near = offset.abs().amax(dim=-1), offset.abs().amin(dim=-1)
    faces = (far < 0.5) | ((far < 0.5 + REACH) & (near < 0.5))
    return regions.there[:, None, None, None] & fits[:, :, None, None] & faces[:, None]


def complete_iou(a: Tensor, b: Tensor) -> Tensor:
    """CIOU of boxes (..., 4), centre x, centre y, width, height: IOU less centre distance less difference of aspect.

    Returns:
        (...) at most 1, where the boxes are the same.
    """
    a_low, a_high = a[..., :2] - a[..., 2:] / 2, a[..., :2] + a[..., 2:] / 2
    b_low, b_high = b[..., :2] - b[..., 2:] / 2, b[..., :2] + b[..., 2:] / 2
    common = (torch.minimum(a_high, b_high) - torch.maximum(a_low, b_low)).clamp(min=0.0).prod(dim=-1)
    union = a[..., 2:].prod(dim=-1) + b[..., 2:].prod(dim=-1) - common + TINY
    iou = common / union
    hull = (torch.maximum(a_high, b_high) - torch.minimum(a_low, b_low)).square().sum(dim=-1) + TINY
    apart = (a[..., :2] - b[..., :2]).square().sum(dim=-1) / hull
    slant = torch.atan(a[..., 2] / (a[..., 3] + TINY)) - torch.atan(b[..., 2] / (b[..., 3] + TINY))
    aspect = (4.0 / math.pi**2) * slant.square()
    with torch.no_grad():
        weight = aspect / (1.0 - iou + aspect + TINY)
    return iou - apart - weight * aspect


def roi_loss(raw: list[Tensor], regions: Regions, anchors: Tensor) -> dict[str, Tensor]:
    """The two terms of the loss, weighted: regions that answer are placed by CIOU, and score what they reach.

    Args:
        raw: of `RoiNetwork.forward_raw`.
        regions: the truth.
        anchors: of `RoiNetwork.anchors`.

    Returns:
        {"box", "score"}: scalars with gradient; their sum is the loss.
    """
    box = raw[0].new_zeros(())
    score = raw[0].new_zeros(())
    for grid, own, balance in zip(raw, anchors, BALANCE):
        answers = answering_cells(regions, own, *grid.shape[2:4])
        wanted = torch.zeros_like(grid[..., 4])
        if bool(answers.any()):
            truth = regions.boxes[:, None, None, None].expand(*answers.shape, 4)[answers]
            overlap = complete_iou(decode_boxes(grid, own)[answers], truth)
            box = box + (1.0 - overlap).mean()
            wanted[answers] = overlap.detach().clamp(min=0.0).to(wanted.dtype)
        score = score + balance * F.binary_cross_entropy_with_logits(grid[..., 4], wanted)
    return {"box": BOX_GAIN * box, "score": SCORE_GAIN * score}
