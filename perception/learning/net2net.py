"""A wider StairNetV2 that starts where a narrower one has arrived.

Every channel is doubled and what reads it is halved, so that the wide network computes what the narrow one does
(Net2Net: Chen, Goodfellow, Shlens, "Accelerating learning via knowledge transfer", 2016). A little noise tells the
twins apart, and training goes on from there: on a CPU the only way to the wide versions in less than a day.
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from perception.inference.weights import WeightsError, load_weights
from perception.network import StairNetV2
from stair_env.common.constants import NETWORK_WIDTHS

SELECTIVE_LAYER = "selective.select"  # its outputs are two descriptors after each other, each to be doubled by itself


def widened(network: StairNetV2, width: float, *, jitter: float = 0.05, seed: int = 0) -> StairNetV2:
    """The same function in a wider network.

    Args:
        network: trained.
        width: of the result: that of `network` times a power of two.
        jitter: standard deviation of the noise on each weight, relative to the spread of its tensor; 0 keeps the
            function to rounding, but then twins learn the same for ever.
        seed: of the noise.

    Returns:
        In evaluation mode.

    Raises:
        ValueError: no such width, or a narrower one.
    """
    if width not in NETWORK_WIDTHS or width < network.width:
        raise ValueError(
            f"width={width!r} must be one of {', '.join(str(w) for w in NETWORK_WIDTHS if w >= network.width)}"
        )
    if jitter < 0.0:
        raise ValueError(f"jitter={jitter!r} must be >= 0")
    generator = torch.Generator().manual_seed(seed)
    while network.width < width:
        wide = StairNetV2(2.0 * network.width, network.fusion_stage)
        narrow = network.state_dict()
        state = {name: _doubled(name, narrow[name], like) for name, like in wide.state_dict().items()}
        wide.load_state_dict(state)
        network = wide
        with torch.no_grad():
            for parameter in network.parameters():
                if jitter and parameter.dim() > 1:
                    noise = torch.randn(parameter.shape, generator=generator)
                    parameter.add_(jitter * parameter.std() * noise)
    return network.eval()


def _doubled(name: str, narrow: Tensor, like: Tensor) -> Tensor:
    """A tensor of the narrow network in the shape of its wide counterpart."""
    if name.startswith(SELECTIVE_LAYER):
        rows = narrow.view(2, -1, *narrow.shape[1:])
        narrow = torch.cat([rows, rows], 1).flatten(0, 1)
    for axis in range(narrow.dim()):
        if like.shape[axis] == 2 * narrow.shape[axis]:
            narrow = torch.cat([narrow, narrow], axis)
            if axis == 1:  # inputs come twice now
                narrow = narrow / 2
    return narrow


def load_starting_point(path: str | Path, width: float, fusion_stage: int = 2, seed: int = 0) -> StairNetV2:
    """A network to train on, from a file of its own width or of a narrower one, which is widened.

    Args:
        path: safetensors file.
        width: of the network wanted.
        fusion_stage: of both.
        seed: of the noise that tells a widened network's twins apart.

    Raises:
        WeightsError: the file is missing, no safetensors, or of no such network.
    """
    reason = WeightsError(f"{path}: no widths to try")
    for candidate in sorted((w for w in NETWORK_WIDTHS if w <= width), reverse=True):
        try:
            return widened(load_weights(path, candidate, fusion_stage), width, seed=seed)
        except WeightsError as error:
            reason = error
    raise WeightsError(f"{path}: not the weights of width={width} or of a narrower one") from reason
