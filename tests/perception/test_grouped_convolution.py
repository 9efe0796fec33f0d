"""`perception.grouped_convolution`: torch's convolution, faster."""

import pytest
import torch
from torch.nn import functional as F

from perception.grouped_convolution import grouped_convolution
from perception.network import GroupedConv3x3, StairNetV2, use_compiled_convolutions, use_merged_norms


@pytest.fixture
def threads():
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_images_are_shared_out_among_threads(threads, count):
    threads(count)
    x, weight = torch.randn(5, 8, 9, 7, requires_grad=True), torch.randn(8, 4, 3, 3, requires_grad=True)
    answers = []
    for convolve in (
        lambda: F.conv2d(x, weight, None, 1, (2, 1), (2, 1), 2),
        lambda: grouped_convolution(x, weight, None, 1, (2, 1)),
    ):
        x.grad = weight.grad = None
        y = convolve()
        y.square().sum().backward()
        answers.append([y.detach(), x.grad, weight.grad])
    for theirs, ours in zip(*answers, strict=True):
        torch.testing.assert_close(ours, theirs, atol=1e-3, rtol=1e-4)


def test_it_takes_tensors_whatever_their_memory_order():
    x, weight = torch.randn(2, 8, 16, 16), torch.randn(8, 2, 3, 3)
    there = x.to(memory_format=torch.channels_last), weight.transpose(2, 3).contiguous().transpose(2, 3)
    torch.testing.assert_close(
        grouped_convolution(*there, None, 2, (1, 1)), grouped_convolution(x, weight, None, 2, (1, 1))
    )


def test_only_float32_on_the_processor_is_taken_by_it():
    conv, x = GroupedConv3x3(8, 4), torch.randn(1, 8, 8, 8)
    plain = conv(x)
    use_compiled_convolutions(conv)
    torch.testing.assert_close(conv(x), plain)
    with torch.autocast("cpu", torch.bfloat16):
        assert conv(x).dtype == torch.bfloat16
    assert conv.double()(x.double()).dtype == torch.float64


def test_a_network_trains_alike_with_it():
    torch.manual_seed(0)
    network = StairNetV2(0.25).eval()
    use_merged_norms(network)
    rgb, depth = torch.randn(2, 3, 64, 64), torch.randn(2, 1, 64, 64)
    gradients = []
    for compiled in (False, True):
        use_compiled_convolutions(network, compiled)
        network.zero_grad()
        raw = network.forward_raw(rgb, depth)
        (raw.cls_logits.square().sum() + raw.loc.square().sum()).backward()
        gradients.append([p.grad.clone() for p in network.parameters()])
    for theirs, ours in zip(*gradients, strict=True):
        torch.testing.assert_close(ours, theirs, atol=1e-4, rtol=1e-3)
