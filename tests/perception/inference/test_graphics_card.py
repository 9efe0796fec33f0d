import numpy as np
import onnxruntime
import pytest
import torch

from perception.inference.backends import BackendError, OnnxBackend, TorchBackend, make_backend
from perception.inference.graphics_card import CPU, CUDA, TENSORRT, GraphicsCardBackend, _options
from perception.inference.weights import WeightsError, weights_path
from stair_env.common.constants import GPU_BACKENDS

SHIPPED = weights_path(0.25, "onnx")


@pytest.fixture(scope="module")
def frames():
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (5, 512, 512, 3)).astype(np.uint8)
    return rgb, rng.uniform(0.3, 4.0, (5, 512, 512)).astype(np.float32)


def test_whole_batches_give_what_single_frames_give(frames):
    """On the processor as a provider: the way batches are cut does not depend on the card."""
    cls, loc = GraphicsCardBackend(SHIPPED, CPU, max_batch=2)(*frames)
    alone = OnnxBackend(0.25, threads=1)(*frames)
    np.testing.assert_allclose(cls, alone[0], atol=1e-4)
    np.testing.assert_allclose(loc, alone[1], atol=1e-4)
    assert cls.shape == (5, 32, 16) and loc.shape == (5, 32, 16, 8)
    assert [part.shape for part in GraphicsCardBackend(SHIPPED, CPU)(frames[0][:0], frames[1][:0])] == [
        (0, 32, 16),
        (0, 32, 16, 8),
    ]


@pytest.mark.parametrize("provider", [CUDA, TENSORRT])
def test_a_provider_that_is_not_there_is_named_with_the_way_to_get_it(provider):
    if provider in onnxruntime.get_available_providers():
        pytest.skip(f"this onnxruntime has {provider}")
    with pytest.raises(BackendError, match=f"{provider}.*onnxruntime-gpu"):
        GraphicsCardBackend(SHIPPED, provider)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a graphics card")
@pytest.mark.parametrize("name", GPU_BACKENDS)
def test_back_ends_of_a_card_are_refused_without_one(name):
    with pytest.raises(BackendError):
        make_backend(name)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a graphics card")
@pytest.mark.parametrize("name", GPU_BACKENDS)
def test_a_card_agrees_with_the_processor(name, frames):
    try:
        backend = make_backend(name)
    except BackendError as error:
        pytest.skip(str(error))
    np.testing.assert_allclose(backend(*frames)[0], OnnxBackend(0.25)(*frames)[0], atol=1e-3)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a graphics card")
def test_torch_says_why_it_has_no_card():
    with pytest.raises(BackendError, match="sees no graphics card"):
        TorchBackend(device="cuda")


def test_wrong_arguments_are_named(tmp_path):
    with pytest.raises(ValueError, match="max_batch"):
        GraphicsCardBackend(SHIPPED, CPU, max_batch=0)
    with pytest.raises(WeightsError, match="no such file"):
        GraphicsCardBackend(tmp_path / "none.onnx", CPU)
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(SHIPPED.read_bytes()[:1000])
    with pytest.raises(WeightsError, match="cannot be loaded"):
        GraphicsCardBackend(broken, CPU)


def test_tensorrt_compiles_for_every_batch_it_may_meet(monkeypatch, tmp_path):
    options = _options(TENSORRT, 4)
    assert options["trt_profile_min_shapes"].startswith("rgb:1x3x512x512,depth:1x1")
    assert options["trt_profile_max_shapes"].startswith("rgb:4x3x512x512")
    assert "trt_engine_cache_enable" not in options
    monkeypatch.setenv("STAIR_ENV_TENSORRT_CACHE", str(tmp_path))
    assert _options(TENSORRT, 4)["trt_engine_cache_path"] == str(tmp_path)
    assert _options(CUDA, 4) == {}
