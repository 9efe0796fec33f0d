"""A copy of the network for inference: batch norm folded into the convolutions before it."""

from __future__ import annotations

import copy
from typing import TypeVar

from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from perception.network import Bottleneck, Focus, GroupedConv3x3

Network = TypeVar("Network", bound=nn.Module)


def folded(network: Network, *, dense: bool = False) -> Network:
    """The same function with fewer operations: of any network of ours, the paper's opponents too.

    Args:
        network: left as it is.
        dense: store grouped convolutions as dense ones, zero between the groups.

    Returns:
        A network in evaluation mode without batch norm; it can no longer be trained or saved as weights.
    """
    network = copy.deepcopy(network).cpu().eval().requires_grad_(False)
    for module in network.modules():
        if isinstance(module, Bottleneck):
            _fold_bottleneck(module, dense)
        elif isinstance(module, nn.Sequential) and [*map(type, module.children())][:2] == [nn.Conv2d, nn.BatchNorm2d]:
            module[0], module[1] = _fused(module[0], module[1]), nn.Identity()
    for module in list(network.modules()):
        for name, child in module.named_children():
            if isinstance(child, Focus):
                setattr(module, name, _strided(child))
    return network


def _fold_bottleneck(block: Bottleneck, dense: bool) -> None:
    spatial = _fused(_plain(block.spatial, dense), block.spatial_norm)
    block.spatial, block.spatial_norm = spatial, nn.Identity()  # type: ignore[assignment]
    block.expand, block.expand_norm = _fused(block.expand, block.expand_norm), nn.Identity()  # type: ignore[assignment]
    if isinstance(block.shortcut, nn.Sequential):
        block.shortcut = _fused(block.shortcut[0], block.shortcut[1])


def _strided(focus: Focus) -> nn.Sequential:
    """A tensor slice and its folded 1 x 1 convolution as one 2 x 2 convolution of stride 2.

    The slice alone took a sixth of ONNX Runtime's time at 0.25x, which shuffles the picture element by element.
    """
    mix = focus.mix[0]
    assert isinstance(mix, nn.Conv2d)
    conv = nn.Conv2d(mix.in_channels // 4, mix.out_channels, 2, 2)
    conv.weight = nn.Parameter(mix.weight.reshape(conv.weight.shape), requires_grad=False)
    conv.bias = mix.bias
    return nn.Sequential(conv, nn.ReLU(inplace=True)).eval()


def _fused(conv: nn.Module, norm: nn.Module) -> nn.Conv2d:
    assert isinstance(conv, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d)
    return fuse_conv_bn_eval(conv, norm)


def _plain(conv: GroupedConv3x3, dense: bool) -> nn.Conv2d:
    """The convolution as torch's own module."""
    groups = 1 if dense else conv.groups
    d = conv.dilation
    plain = nn.Conv2d(conv.channels, conv.channels, 3, conv.stride, d, d, groups, bias=False)
    plain.weight = nn.Parameter(
        (conv.dense_weight(conv.weight) if dense else conv.weight).detach().clone(), requires_grad=False
    )
    return plain.eval()
