import numpy as np
import pytest
import torch

from perception.inference.backends import TorchBackend
from perception.network import StairNetV2
from perception.reproduction.baselines.other_fusions import ConcatenatingStairNet, FourChannelStairNet

FUSIONS = (ConcatenatingStairNet, FourChannelStairNet)


def count(network):
    return sum(parameter.numel() for parameter in network.parameters())


@pytest.mark.parametrize("kind", FUSIONS)
def test_only_the_fusion_differs(kind):
    """Trunk, neck and heads are StairNetV2's by name and shape."""
    ours, plain = kind(0.25).state_dict(), StairNetV2(0.25).state_dict()
    behind = [name for name in plain if name.split(".")[0] in ("trunk", "neck", "cls_head", "loc_head")]
    assert behind and all(ours[name].shape == plain[name].shape for name in behind)


def test_one_branch_costs_less_than_two():
    assert count(FourChannelStairNet(0.25)) < count(StairNetV2(0.25)) < 1.05 * count(ConcatenatingStairNet(0.25))


@pytest.mark.parametrize("kind", FUSIONS)
def test_both_modalities_reach_the_answer_and_every_weight_learns(kind):
    torch.manual_seed(0)
    network = kind(0.25).train()
    rgb, depth = torch.randn(2, 3, 64, 64, requires_grad=True), torch.randn(2, 1, 64, 64, requires_grad=True)
    raw = network.forward_raw(rgb, depth)
    assert raw.cls_logits.shape == (2, 1, 4, 2) and raw.loc.shape == (2, 8, 4, 2)
    (raw.cls_logits.sum() + raw.loc.sum()).backward()
    assert rgb.grad.abs().sum() > 0.0 and depth.grad.abs().sum() > 0.0
    assert all(parameter.grad is not None for parameter in network.parameters())


@pytest.mark.parametrize("kind", FUSIONS)
def test_they_run_behind_the_same_back_end(kind):
    backend = TorchBackend(network=kind(0.25).eval())
    cls, loc = backend(np.zeros((1, 512, 512, 3), np.uint8), np.ones((1, 512, 512), np.float32))
    assert cls.shape == (1, 32, 16) and loc.shape == (1, 32, 16, 8)
