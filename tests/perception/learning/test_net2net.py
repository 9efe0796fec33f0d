import pytest
import torch
from safetensors.torch import save_file

from perception.inference.weights import WeightsError
from perception.learning.net2net import load_starting_point, widened
from perception.network import FUSION_STAGES, StairNetV2


def trained(width: float = 0.25, fusion_stage: int = 2) -> StairNetV2:
    """A network whose every tensor, running statistics included, is far from its start."""
    torch.manual_seed(0)
    network = StairNetV2(width, fusion_stage)
    for name, tensor in network.state_dict().items():
        if tensor.is_floating_point():
            tensor.add_(0.1 * torch.rand_like(tensor) if "var" in name else 0.05 * torch.randn_like(tensor))
    return network.eval()


def frames() -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return torch.rand(2, 3, 64, 64, generator=generator), torch.rand(2, 1, 64, 64, generator=generator)


@pytest.mark.parametrize("width", [0.5, 1.0])
@pytest.mark.parametrize("fusion_stage", FUSION_STAGES)
def test_without_noise_the_wide_network_is_the_same_function(width, fusion_stage):
    narrow = trained(fusion_stage=fusion_stage)
    wide = widened(narrow, width, jitter=0.0)
    assert wide.width == width and wide.fusion_stage == fusion_stage
    with torch.no_grad():
        for ours, theirs in zip(wide(*frames()), narrow(*frames()), strict=True):
            assert torch.allclose(ours, theirs, atol=2e-5)
            assert theirs.std() > 1e-4


def test_noise_tells_twins_apart_and_changes_little():
    narrow = trained()
    wide = widened(narrow, 0.5, jitter=0.02)
    weight = wide.trunk[0][0].expand.weight
    half = len(weight) // 2
    assert not torch.allclose(weight[:half], weight[half:])
    with torch.no_grad():
        assert (wide(*frames())[0] - narrow(*frames())[0]).abs().max() < 0.1
    assert all(torch.equal(a, b) for a, b in zip(wide.parameters(), widened(narrow, 0.5, jitter=0.02).parameters()))


@pytest.mark.parametrize(("width", "jitter"), [(0.25, 0.0), (0.75, 0.0), (1.0, -1.0)])
def test_wrong_arguments(width, jitter):
    with pytest.raises(ValueError, match="must be"):
        widened(StairNetV2(0.5), width, jitter=jitter)


def test_a_narrower_file_is_a_starting_point_and_a_wider_one_is_not(tmp_path):
    path, wide = tmp_path / "narrow.safetensors", tmp_path / "wide.safetensors"
    save_file(trained().state_dict(), path)
    save_file(StairNetV2(0.5).state_dict(), wide)
    assert load_starting_point(path, 0.25).width == 0.25
    assert load_starting_point(path, 0.5).width == 0.5
    with pytest.raises(WeightsError, match=r"not the weights of width=0\.25 or of a narrower one"):
        load_starting_point(wide, 0.25)
    with pytest.raises(WeightsError, match="narrower"):
        load_starting_point(tmp_path / "nothing.safetensors", 0.5)
