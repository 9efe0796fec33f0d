"""The loss that tells the selective module which modality says more of a frame."""

import copy

import pytest
import torch

from perception.learning.losses import GridTargets, LossWeights, frame_losses, total_loss
from perception.learning.trust import SHARPNESS, SelectionFit, colour_share, trust_loss
from perception.network import StairNetV2

WEIGHTS = LossWeights(3.0, 5.0)
BLANK = -1.0  # black, and no reading


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    network = StairNetV2(0.25).eval()
    for parameter in network.parameters():
        parameter.data.add_(0.05 * torch.randn_like(parameter))
    return network


@pytest.fixture(scope="module")
def batch():
    torch.manual_seed(1)
    rgb, depth = torch.randn(3, 3, 128, 128).clamp(-1, 1), torch.randn(3, 1, 128, 128).clamp(-1, 1)
    cls = (torch.rand(3, 1, 8, 4) < 0.4).float()
    return rgb, depth, GridTargets(cls, torch.rand(3, 8, 8, 4) * cls)


def share_of(network, rgb, depth, targets):
    return colour_share(network, network.rgb_branch(rgb), network.depth_branch(depth), targets, WEIGHTS)


def test_share_is_depths_part_of_the_losses_by_either_alone(network, batch):
    rgb, depth, targets = batch
    with torch.no_grad():
        by_colour, by_depth = (
            total_loss(frame_losses(network.forward_raw(*pair), targets), WEIGHTS) ** SHARPNESS
            for pair in ((rgb, torch.full_like(depth, BLANK)), (torch.full_like(rgb, BLANK), depth))
        )
    expected = by_depth / (by_colour + by_depth)
    assert torch.allclose(share_of(network, rgb, depth, targets), expected, atol=1e-5)
    assert float(expected.std()) > 0.0, "frames must differ for this to say anything"


def test_modalities_that_say_nothing_share_evenly(network, batch):
    rgb, depth, targets = batch
    nothing = torch.full_like(rgb, BLANK), torch.full_like(depth, BLANK)
    assert torch.allclose(share_of(network, *nothing, targets), torch.full((3,), 0.5), atol=1e-5)


def test_share_asks_and_does_not_teach(network, batch):
    before = {name: value.clone() for name, value in network.state_dict().items()}
    assert not share_of(network, *batch).requires_grad
    assert all(torch.equal(value, before[name]) for name, value in network.state_dict().items())


def test_descending_the_loss_moves_every_channel_as_asked_and_leaves_its_mean():
    logits = torch.randn(4, 2, 5, generator=torch.Generator().manual_seed(3), requires_grad=True)
    before = (logits[:, 0] - logits[:, 1]).mean(0).detach()
    share = torch.tensor([0.1, 0.4, 0.6, 0.9])
    optimiser = torch.optim.SGD([logits], lr=5.0)
    for _ in range(300):
        optimiser.zero_grad()
        trust_loss(logits, share).backward()
        optimiser.step()
    after = (logits[:, 0] - logits[:, 1]).detach()
    assert torch.allclose(after - after.mean(0), torch.logit(share)[:, None].expand(4, 5), atol=0.05)
    assert torch.allclose(after.mean(0), before, atol=1e-4)
    assert float(trust_loss(logits[:1], share[:1])) == 0.0


def test_a_fitted_selection_follows_what_the_features_tell_and_keeps_the_channels_means(network):
    module = copy.deepcopy(network.selective)
    pooled = torch.randn(400, module.select.in_features, generator=torch.Generator().manual_seed(4)) + 0.3
    truth = torch.sigmoid(0.8 * pooled[:, 3] - 0.5 * pooled[:, 7] + 0.2)
    fit = SelectionFit(module.select.in_features)
    for part in range(0, 400, 80):
        fit.add(pooled[part : part + 80], truth[part : part + 80])

    def odds():
        pair = module.select(pooled).view(400, 2, -1)
        return (pair[:, 0] - pair[:, 1]).detach()

    before = odds()
    assert fit.apply(module) > 0.98
    change = odds() - before
    assert torch.allclose(change.mean(0), torch.zeros(change.shape[1]), atol=1e-4)
    asked = torch.logit(truth)
    assert torch.allclose(change, (asked - asked.mean())[:, None].expand_as(change), atol=0.1)


def test_a_fit_to_noise_explains_little_and_changes_little(network):
    module = copy.deepcopy(network.selective)
    generator = torch.Generator().manual_seed(5)
    fit = SelectionFit(module.select.in_features)
    fit.add(torch.randn(2000, module.select.in_features, generator=generator), torch.rand(2000, generator=generator))
    before = module.select.weight.detach().clone()
    assert fit.apply(module) < 0.06
    assert float((module.select.weight - before).abs().max()) < 0.1
