import importlib.util
import subprocess
import sys

import numpy as np
import pytest
import torch

from perception.inference.backends import (
    BackendError,
    OnnxBackend,
    OpenVinoBackend,
    TorchBackend,
    make_backend,
    make_exported_backend,
)
from perception.inference.detector import NetworkDetector
from perception.inference.weights import (
    WeightsError,
    available_widths,
    load_network,
    load_weights,
    read_card,
    save_weights,
    weights_path,
)
from perception.network import StairNetV2
from stair_env.common.constants import NETWORK_WIDTHS

needs_openvino = pytest.mark.skipif(importlib.util.find_spec("openvino") is None, reason="openvino is not installed")


def random_network(width: float = 0.25) -> StairNetV2:
    torch.manual_seed(1)
    network = StairNetV2(width)
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.normal_(0.0, 0.1)
            module.running_var.uniform_(0.5, 2.0)
            torch.nn.init.uniform_(module.weight, 0.5, 1.5)
        if isinstance(module, torch.nn.Conv2d) and module.bias is not None:
            torch.nn.init.normal_(module.weight, std=0.3)  # the heads, so that answers spread over 0..1
    return network.eval()


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("weights")
    network = random_network()
    save_weights(network, folder, {"model": "test"})
    return folder, network


@pytest.fixture(scope="module")
def frames():
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (3, 512, 512, 3)).astype(np.uint8)
    depth = rng.uniform(0.0, 4.0, (3, 512, 512)).astype(np.float32)
    depth[:, :100] = 0.0
    return rgb, depth


def test_backends_agree(saved, frames):
    folder, network = saved
    onnx = OnnxBackend(path=weights_path(0.25, "onnx", folder), threads=1)
    cls, loc = onnx(*frames)
    assert cls.shape == (3, 32, 16)
    assert loc.shape == (3, 32, 16, 8)
    assert loc.std() > 0.03  # the comparison would be empty otherwise
    for other in (TorchBackend(network=network)(*frames), TorchBackend(network=load_network(0.25, folder))(*frames)):
        np.testing.assert_allclose(other[0], cls, atol=1e-3)
        np.testing.assert_allclose(other[1], loc, atol=1e-3)


def test_exported_files_name_no_source_files(saved):
    assert b".py" not in weights_path(0.25, "onnx", saved[0]).read_bytes()
    for width in available_widths("onnx"):
        assert b".py" not in weights_path(width, "onnx").read_bytes()


@needs_openvino
def test_openvino_agrees(saved, frames):
    path = weights_path(0.25, "onnx", saved[0])
    cls, loc = OnnxBackend(path=path, threads=1)(*frames)
    exact = OpenVinoBackend(path=path, threads=1)(*frames)
    np.testing.assert_allclose(exact[0], cls, atol=1e-3)
    np.testing.assert_allclose(exact[1], loc, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "threads"),
    [("onnx", 1), ("onnx", 2), *(pytest.param("openvino", n, marks=needs_openvino) for n in (1, 2))],
)
def test_any_batch_size(saved, frames, name, threads):
    backend = make_exported_backend(name, weights_path(0.25, "onnx", saved[0]), threads)
    cls, loc = backend(*frames)
    alone = backend(frames[0][2:], frames[1][2:])
    np.testing.assert_allclose(alone[0][0], cls[2], atol=1e-5)
    np.testing.assert_allclose(alone[1][0], loc[2], atol=1e-5)
    none = backend(frames[0][:0], frames[1][:0])
    assert none[0].shape == (0, 32, 16)
    assert none[1].shape == (0, 32, 16, 8)


def test_weights_round_trip(saved):
    folder, network = saved
    assert available_widths("safetensors", folder) == (0.25,)
    assert read_card(0.25, folder) == {"model": "test"}
    for name, tensor in load_network(0.25, folder).state_dict().items():
        torch.testing.assert_close(tensor, network.state_dict()[name])


@pytest.mark.parametrize("width", [1.0, 0.5])
def test_missing_weights_name_what_is_there(saved, width):
    with pytest.raises(WeightsError, match=r"there are: 0\.25"):
        load_network(width, saved[0])


def test_weights_of_another_network_are_refused(saved, tmp_path):
    path = weights_path(0.25, "safetensors", saved[0])
    with pytest.raises(WeightsError, match=r"width=0\.5"):
        load_weights(path, 0.5)
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(b"nothing")
    with pytest.raises(WeightsError, match=r"broken\.safetensors"):
        load_weights(broken, 0.25)
    with pytest.raises(WeightsError, match="cannot be loaded"):
        OnnxBackend(path=broken)


@needs_openvino
def test_openvino_refuses_what_is_no_network(saved, tmp_path):
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"nothing")
    with pytest.raises(WeightsError, match=r"broken\.onnx: cannot be loaded"):
        OpenVinoBackend(path=broken)
    with pytest.raises(WeightsError, match="no such file"):
        OpenVinoBackend(path=tmp_path / "missing.onnx")


def test_without_openvino_the_error_says_how_to_install_it(saved, monkeypatch):
    monkeypatch.setitem(sys.modules, "openvino", None)  # as if it were not there
    with pytest.raises(BackendError, match=r"stair-env\[openvino\]"):
        make_exported_backend("openvino", weights_path(0.25, "onnx", saved[0]))


def test_export_command_writes_the_same_network(saved, frames, tmp_path):
    from stair_env_cli.main import main

    name = weights_path(0.25, "safetensors", saved[0]).name
    (tmp_path / name).write_bytes((saved[0] / name).read_bytes())
    assert main(["perception-export", "--weights", str(tmp_path)]) == 0
    ours, theirs = (OnnxBackend(path=weights_path(0.25, "onnx", folder)) for folder in (tmp_path, saved[0]))
    np.testing.assert_allclose(ours(*frames)[1], theirs(*frames)[1], atol=1e-6)
    assert main(["perception-export", "--weights", str(tmp_path), "--width", "0.5"]) != 0


def test_wrong_names_list_the_choices(saved):
    with pytest.raises(ValueError, match="onnx"):
        make_backend("tensorrt")
    with pytest.raises(ValueError, match="openvino"):
        make_exported_backend("torch", weights_path(0.25, "onnx", saved[0]))
    with pytest.raises(WeightsError, match=r"1\.0, 0\.5, 0\.25"):
        weights_path(0.3)
    with pytest.raises(WeightsError, match="safetensors, onnx, json"):
        weights_path(0.25, "pt")
    with pytest.raises(ValueError, match="threads=0"):
        OnnxBackend(path=weights_path(0.25, "onnx", saved[0]), threads=0)


@pytest.mark.parametrize(
    ("rgb", "depth"),
    [
        (np.zeros((1, 512, 512, 3), np.float32), np.zeros((1, 512, 512), np.float32)),
        (np.zeros((1, 256, 256, 3), np.uint8), np.zeros((1, 256, 256), np.float32)),
        (np.zeros((1, 512, 512, 3), np.uint8), np.zeros((2, 512, 512), np.float32)),
        (np.zeros((1, 512, 512, 3), np.uint8), np.zeros((1, 512, 512), np.uint16)),
    ],
)
def test_wrong_frames_are_named(saved, rgb, depth):
    onnx = OnnxBackend(path=weights_path(0.25, "onnx", saved[0]), threads=1)
    with pytest.raises(ValueError, match="must be"):
        onnx(rgb, depth)


def test_detector_takes_images_of_any_size(saved):
    detector = NetworkDetector(backend=OnnxBackend(path=weights_path(0.25, "onnx", saved[0]), threads=1))
    images = [np.full((480, 640, 3), 80, np.uint8), np.full((90, 160, 3), 80, np.uint8)]
    cls, loc = detector.detect(images, [np.ones(image.shape[:2], np.float32) for image in images])
    assert cls.shape == (2, 32, 16)
    assert loc.shape == (2, 32, 16, 8)
    assert detector.detect([], [])[0].shape == (0, 32, 16)


def test_onnx_path_does_not_import_torch(saved):
    path = weights_path(0.25, "onnx", saved[0])
    code = (
        "import sys, numpy as np; from perception.inference.backends import OnnxBackend;"
        f"OnnxBackend(path={str(path)!r}, threads=1)(np.zeros((1, 512, 512, 3), np.uint8), np.zeros((1, 512, 512)));"
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("width", NETWORK_WIDTHS)
def test_shipped_weights_load(width):
    network = load_network(width)
    rgb, depth = np.zeros((1, 512, 512, 3), np.uint8), np.full((1, 512, 512), 2.0, np.float32)
    for a, b in zip(OnnxBackend(width, threads=1)(rgb, depth), TorchBackend(network=network)(rgb, depth), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-3)
    assert read_card(width)["width"] == width
