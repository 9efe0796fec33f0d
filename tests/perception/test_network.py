import pytest
import torch

from perception.inference.batchnorm_fusion import folded
from perception.network import (
    FUSION_STAGES,
    GroupedConv3x3,
    SelectiveModule,
    StairNetV2,
    state_dict_megabytes,
    use_merged_norms,
)
from stair_env.common.constants import NETWORK_WIDTHS

PAPER_MEGABYTES = {1.0: 10.4, 0.5: 2.87, 0.25: 0.95}  # table 4


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


def shaken(network: StairNetV2) -> StairNetV2:
    """The network with batch-norm statistics and gains that make every layer matter."""
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.normal_(0.0, 0.1)
            module.running_var.uniform_(0.5, 2.0)
            torch.nn.init.uniform_(module.weight, 0.5, 1.5)
    return network


@pytest.mark.parametrize("width", NETWORK_WIDTHS)
def test_size_is_that_of_table_4(width):
    assert state_dict_megabytes(StairNetV2(width)) == pytest.approx(PAPER_MEGABYTES[width], rel=0.04)


@pytest.mark.parametrize("fusion_stage", FUSION_STAGES)
def test_output_grid_and_ranges(fusion_stage):
    network = StairNetV2(0.25, fusion_stage).eval()
    with torch.inference_mode():
        cls, loc = network(torch.randn(1, 3, 512, 512), torch.randn(1, 1, 512, 512))
    assert cls.shape == (1, 1, 32, 16)
    assert loc.shape == (1, 8, 32, 16)
    assert ((cls >= 0) & (cls <= 1)).all()
    assert ((loc >= 0) & (loc <= 1)).all()


@pytest.mark.parametrize("fusion_stage", FUSION_STAGES)
def test_selective_module_sits_after_the_chosen_downsampling(fusion_stage):
    network = StairNetV2(0.25, fusion_stage).eval()
    sides = []
    network.selective.register_forward_hook(lambda _m, inputs, _o: sides.append(inputs[0].shape[-1]))
    with torch.inference_mode():
        network(torch.zeros(1, 3, 128, 128), torch.zeros(1, 1, 128, 128))
    assert sides == [128 // 2**fusion_stage]


@pytest.mark.parametrize("dense", [False, True])
def test_merged_norms_change_neither_answer_nor_gradients(dense):
    network = shaken(StairNetV2(0.25)).eval().use_dense_convolutions(dense).double()
    rgb, depth = torch.randn(2, 3, 64, 64).double(), torch.randn(2, 1, 64, 64).double()

    def answer_and_gradients():
        network.zero_grad()
        raw = network.forward_raw(rgb, depth)
        (raw.cls_logits.square().sum() + raw.loc.sum()).backward()
        return [raw.cls_logits.detach(), raw.loc.detach(), *(p.grad.clone() for p in network.parameters())]

    apart = answer_and_gradients()
    use_merged_norms(network)
    for plain, merged in zip(apart, answer_and_gradients(), strict=True):
        torch.testing.assert_close(merged, plain, rtol=1e-6, atol=1e-8)


def test_answer_does_not_depend_on_the_rest_of_the_batch():
    network = shaken(StairNetV2(0.25)).eval()
    rgb, depth = torch.randn(3, 3, 128, 128), torch.randn(3, 1, 128, 128)
    with torch.inference_mode():
        whole, alone = network(rgb, depth), network(rgb[1:2], depth[1:2])
    for a, b in zip(whole, alone, strict=True):
        torch.testing.assert_close(a[1:2], b, atol=1e-5, rtol=1e-4)


def test_both_inputs_matter():
    network = shaken(StairNetV2(0.25)).eval()
    rgb, depth = torch.randn(1, 3, 128, 128), torch.randn(1, 1, 128, 128)
    with torch.inference_mode():
        plain = network(rgb, depth)[1]
        assert (network(-rgb, depth)[1] - plain).abs().max() > 1e-4
        assert (network(rgb, -depth)[1] - plain).abs().max() > 1e-4


@pytest.mark.parametrize("way", ["dense", "compiled"])
@pytest.mark.parametrize(("stride", "dilation"), [(1, 1), (2, 1), (1, 4), (1, (1, 8)), (2, (2, 3)), (3, 1)])
def test_every_arithmetic_equals_the_grouped(stride, dilation, way):
    conv, bias = GroupedConv3x3(16, 8, stride, dilation), torch.randn(16, requires_grad=True)
    x = torch.randn(3, 16, 24, 21, requires_grad=True)
    results = []
    for chosen in (False, True):
        setattr(conv, way, chosen)
        conv.weight.grad = x.grad = bias.grad = None
        y = conv.convolve(x, conv.weight, bias)
        (y * torch.linspace(-1, 1, y.numel()).view(y.shape)).sum().backward()
        results.append([y.detach(), x.grad, conv.weight.grad, bias.grad])
    for grouped, other in zip(*results, strict=True):
        torch.testing.assert_close(other, grouped, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("fusion_stage", [2, 4])
def test_folding_keeps_the_function(dense, fusion_stage):
    network = shaken(StairNetV2(0.25, fusion_stage)).eval()
    rgb, depth = torch.randn(1, 3, 128, 128), torch.randn(1, 1, 128, 128)
    plain = folded(network, dense=dense)
    assert not any(isinstance(module, torch.nn.BatchNorm2d) for module in plain.modules())
    with torch.inference_mode():
        for a, b in zip(network(rgb, depth), plain(rgb, depth), strict=True):
            torch.testing.assert_close(a, b, atol=1e-4, rtol=1e-3)


def test_selective_weights_of_the_branches_sum_to_one():
    module = SelectiveModule(8)
    same = torch.randn(2, 8, 4, 4)
    torch.testing.assert_close(module(same, same), same)


def test_gradient_reaches_every_parameter():
    network = shaken(StairNetV2(0.25))
    raw = network.forward_raw(torch.randn(2, 3, 64, 64), torch.randn(2, 1, 64, 64))
    (raw.cls_logits.square().sum() + (raw.loc - 0.3).square().sum()).backward()
    without = [name for name, p in network.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert without == []


@pytest.mark.parametrize("arguments", [{"width": 0.3}, {"width": 0.25, "fusion_stage": 1}])
def test_wrong_arguments_name_the_choices(arguments):
    with pytest.raises(ValueError, match="must be one of"):
        StairNetV2(**arguments)
