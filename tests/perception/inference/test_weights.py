"""Files of weights that are foreign or damaged: a named error or a network, never a traceback, and nothing is run."""

from __future__ import annotations

import json
import os
import struct
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from perception.inference.backends import OnnxBackend
from perception.inference.weights import WEIGHTS_DIR, WeightsError, load_weights

TOLD = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
SAFETENSORS, ONNX = ((WEIGHTS_DIR / f"stairnetv2_025.{kind}").read_bytes() for kind in ("safetensors", "onnx"))
READERS = {"safetensors": lambda path: load_weights(path, 0.25), "onnx": lambda path: OnnxBackend(path=path, threads=1)}
ENTRIES = st.fixed_dictionaries(
    {
        "dtype": st.sampled_from(["F32", "F16", "BF16", "F64", "I64", "U16", "BOOL", "F8_E4M3", "F4", "C64", "X", 7]),
        "shape": st.one_of(st.lists(st.integers(-2, 2**40), max_size=3), st.text(max_size=2)),
        "data_offsets": st.one_of(st.lists(st.integers(-1, 2**40), max_size=3), st.just([0, 8])),
    }
)
HEADERS = st.one_of(
    st.dictionaries(st.text(max_size=4), ENTRIES, max_size=3),
    st.dictionaries(st.sampled_from(["__metadata__", "a"]), st.one_of(st.none(), st.text(max_size=3), ENTRIES)),
    st.lists(st.integers(), max_size=2),
)


def reads_or_tells(kind: str, path: Path) -> None:
    try:
        READERS[kind](path)
    except WeightsError as error:
        assert path.name in str(error)


@TOLD
@given(st.one_of(st.binary(max_size=80), HEADERS.map(lambda value: json.dumps(value).encode())), st.integers(0, 2**40))
def test_headers_of_any_kind(tmp_path: Path, header: bytes, claimed: int) -> None:
    path = tmp_path / "foreign.safetensors"
    for length in (len(header), claimed):
        path.write_bytes(struct.pack("<Q", length) + header + b"\0" * 8)
        with pytest.raises(WeightsError, match=r"foreign\.safetensors"):
            load_weights(path, 0.25)


@settings(TOLD, max_examples=25)
@given(st.sampled_from(sorted(READERS)), st.binary(min_size=1, max_size=60), st.floats(0, 1), st.booleans())
def test_files_that_are_written_over(tmp_path: Path, kind: str, noise: bytes, where: float, early: bool) -> None:
    content = {"safetensors": SAFETENSORS, "onnx": ONNX}[kind]
    at = int(where * (2000 if early else len(content) - 1))  # what describes the tensors stands at the beginning
    path = tmp_path / f"damaged.{kind}"
    path.write_bytes(content[:at] + noise + content[at + len(noise) :])
    reads_or_tells(kind, path)


@pytest.mark.parametrize("tenth", range(10))
def test_a_cut_model_is_told(tenth: int, tmp_path: Path) -> None:
    path = tmp_path / "cut.onnx"
    path.write_bytes(ONNX[: len(ONNX) * tenth // 10])
    with pytest.raises(WeightsError, match=r"cut\.onnx"):
        OnnxBackend(path=path)


class Harm:
    """Makes a folder when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.mark),)


@pytest.mark.parametrize("kind", sorted(READERS))
def test_a_pickle_under_their_name_is_not_run(kind: str, tmp_path: Path) -> None:
    path, mark = tmp_path / f"pickle.{kind}", tmp_path / "harmed"
    torch.save({"weights": Harm(mark)}, path)
    with pytest.raises(WeightsError, match="pickle"):
        READERS[kind](path)
    assert not mark.exists()


def constant_model(path: Path, inputs: dict[str, list[int]], outputs: dict[str, list[int]], domain: str = "") -> None:
    from onnx import TensorProto, helper

    nodes = [helper.make_node("Identity" if not domain else "Run", ["rgb"], [name], domain=domain) for name in outputs]
    told = [
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in part.items()]
        for part in (inputs, outputs)
    ]
    domains = [helper.make_opsetid("", 18), *([helper.make_opsetid(domain, 1)] if domain else [])]
    model = helper.make_model(helper.make_graph(nodes, "g", *told), opset_imports=domains, ir_version=9)
    path.write_bytes(model.SerializeToString())


@pytest.mark.parametrize(
    ("inputs", "outputs", "domain", "match"),
    [
        ({"rgb": [1, 3, 512, 512], "depth": [1, 1, 512, 512]}, {"other": [1, 3, 512, 512]}, "", "outputs"),
        ({"rgb": [1, 3, 512, 512], "depth": [1, 1, 512, 512]}, {"cls": [1, 3, 512, 512]}, "", "outputs"),
        ({"rgb": [1, 3, 64, 64]}, {"cls": [1, 3, 64, 64]}, "", "inputs"),
        ({"rgb": [1, 3, 512, 512]}, {"cls": [1, 3, 512, 512]}, "somebody.else", "cannot be loaded"),
    ],
)
def test_a_foreign_model_is_refused_when_it_is_opened(
    inputs: dict[str, list[int]], outputs: dict[str, list[int]], domain: str, match: str, tmp_path: Path
) -> None:
    path = tmp_path / "foreign.onnx"
    constant_model(path, inputs, outputs, domain)
    with pytest.raises(WeightsError, match=rf"foreign\.onnx.*{match}"):
        OnnxBackend(path=path)
