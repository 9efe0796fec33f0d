import pytest
import torch

from perception.inference.backends import OnnxBackend, TorchBackend
from perception.reproduction.gpu_speed import find_card, gpu_table, turns


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a graphics card")
def test_without_a_card_a_sentence_says_so():
    report = gpu_table([0.25], rounds=1)
    assert report["card"] is None and report["rows"] == []
    assert torch.__version__ in report["notes"][0] and report["notes"][0].startswith("No graphics card")
    assert find_card().reason


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a graphics card")
def test_with_a_card_every_width_and_batch_has_a_row():
    report = gpu_table([0.25], rounds=1, batches=(1, 2))
    assert [row["batch"] for row in report["rows"]] == [1, 2]
    assert all(row["training_ms"] > 0.0 for row in report["rows"])


def test_turns_time_each_back_end_and_compare_its_answer():
    """With two back ends of the processor in the card's place."""
    backends = {"onnx": OnnxBackend(0.25, threads=1), "torch": TorchBackend(0.25)}
    rows = turns(backends, 0.25, (1, 2), rounds=1)
    assert [row["batch"] for row in rows] == [1, 2]
    for row in rows:
        assert set(row["ms"]) == set(backends) and min(row["ms"].values()) > 0.0
        assert set(row["off_processor"]) == {"torch"} and row["off_processor"]["torch"] < 1e-3


@pytest.mark.parametrize(("wrong", "name"), [({"rounds": 0}, "rounds"), ({"rounds": 1, "batches": (0,)}, "batches")])
def test_wrong_arguments_are_named(wrong, name):
    with pytest.raises(ValueError, match=name):
        gpu_table([0.25], **wrong)
