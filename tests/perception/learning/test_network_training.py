import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from perception.data.augmentation import AugmentationConfig
from perception.data.label_grid import encode_grid
from perception.data.stair_dataset import Sample, StairDataset
from perception.data.writer import DatasetPlan, write_missing
from perception.learning.frames import EpochSampler, FrameModule, GridFrames, halved
from perception.learning.network_training import StairNetTraining, _flushed_denormals, _usable_precision, train
from perception.learning.presets import PRESETS, TrainingPreset
from perception.network import StairNetV2
from perception.reproduction.table5_detection import as_rows, evaluate_detector, splits_of

QUICK = TrainingPreset(epochs=1, frames_per_epoch=2, batch_size=2, small_batch_size=2, small_share=1.0)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    root = tmp_path_factory.mktemp("set")
    list(write_missing(DatasetPlan(root, {"train": 4, "val": 2}, seed=1)))
    return root


def trained(data, output, preset, resume=False) -> StairNetTraining:
    torch.manual_seed(0)
    module = StairNetTraining(0.25, preset)
    train(module, FrameModule(data, preset, seed=2, validation_frames=2), output, resume=resume, progress=False)
    return module


def test_the_papers_preset():
    paper = PRESETS["paper"]
    assert (paper.epochs, paper.batch_size, paper.weight_decay) == (200, 4, 1e-6)
    assert [paper.rate(epoch) for epoch in (0, 49.9, 50, 199)] == [1e-3, 1e-3, 5e-4, 1.25e-4]
    assert paper.dynamic_weights
    assert not any(paper.is_small(epoch) for epoch in range(200))


def test_cosine_schedule_warms_up_and_falls():
    fast = PRESETS["fast"]
    rates = [fast.rate(epoch) for epoch in np.linspace(0, fast.epochs, 50)]
    peak = int(np.argmax(rates))
    assert 0 < peak < 5
    assert all(a >= b for a, b in zip(rates[peak:], rates[peak + 1 :], strict=False))
    assert rates[-1] == pytest.approx(0.01 * fast.learning_rate)


@pytest.mark.parametrize(
    "wrong",
    [{"epochs": 0}, {"schedule": "linear"}, {"small_share": 2.0}, {"trust_weight": -1.0}, {"trust_weight": 1.0}],
)
def test_wrong_presets_are_named(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        dataclasses.replace(QUICK, **wrong)


def test_epochs_draw_without_repetition_and_differ():
    first, again, second = (list(EpochSampler(100, 60, seed=3, epoch=epoch)) for epoch in (0, 0, 1))
    assert first == again != second
    assert len(set(first)) == 60
    assert len(EpochSampler(10, None, 0, 0)) == 10


def test_several_processes_share_an_epoch_without_overlap():
    whole = list(EpochSampler(101, 61, seed=3, epoch=2))
    shares = [list(EpochSampler(101, 61, seed=3, epoch=2, rank=rank, devices=3)) for rank in range(3)]
    assert {len(share) for share in shares} == {20}
    assert sorted(index for share in shares for index in share) == sorted(whole[:60])


def test_a_batch_that_cannot_be_shared_is_refused(data, tmp_path):
    module = StairNetTraining(0.25, QUICK)
    with pytest.raises(ValueError, match="devices=3 must divide the preset's batch_size=2"):
        train(module, FrameModule(data, QUICK), tmp_path, devices=3)


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["fast", "robust"])
def test_two_processes_train_as_one_and_one_writes(data, tmp_path, preset):
    """Validation counts all frames, shared out; weights and card are whole, the selective module's start summed."""
    command = [
        sys.executable, "-m", "stair_env_cli.main", "perception-train", "--data", str(data), "--epochs", "1",
        "--preset", preset, "--frames-per-epoch", "4", "--small-share", "1", "--accelerator", "cpu", "--threads", "1",
        "--precision", "32-true",
    ]  # fmt: skip
    cards, weights = {}, {}
    for devices in ("1", "2"):
        output = tmp_path / devices
        subprocess.run([*command, "--devices", devices, "--output", str(output)], check=True, timeout=500)
        cards[devices] = json.loads((output / "stairnetv2_025.json").read_text())
        weights[devices] = load_file(output / "stairnetv2_025.safetensors")
    assert cards["1"]["devices"] == 1 and cards["2"]["devices"] == 2
    iou = [cards[devices]["metrics"]["val/iou_model"] for devices in ("1", "2")]
    assert all(0.0 <= value <= 100.0 for value in iou)
    if preset == "robust":  # its batch norms are frozen, so that a batch in halves is the batch
        for name, value in weights["1"].items():
            torch.testing.assert_close(weights["2"][name], value, atol=5e-5, rtol=0.0, msg=name)


def test_half_size_labels_follow_the_image():
    lines = np.array([[32.0, 200.0, 480.0, 260.0]])
    sample = Sample(np.zeros((512, 512, 3), np.uint8), np.ones((512, 512), np.float32), np.array([0]), lines)
    small = halved(sample)
    assert small.depth_m.shape == (256, 256)
    np.testing.assert_allclose(small.lines, lines / 2)
    expected = encode_grid(lines / 2, rows=16, columns=8)
    assert expected.cls.sum() > 0


def test_frames_are_the_same_for_the_same_seed_and_epoch(data):
    frames = StairDataset(data, "train")
    config = AugmentationConfig(photometric=1.0)
    a, b = (GridFrames(frames, config, seed=1, epoch=5)[2] for _ in range(2))
    other = GridFrames(frames, config, seed=1, epoch=6)[2]
    assert all(torch.equal(x, y) for x, y in zip(a, b, strict=True))
    assert not torch.equal(a[0], other[0])


@pytest.mark.slow
def test_a_resumed_run_ends_where_an_uninterrupted_one_does(data, tmp_path):
    two = dataclasses.replace(QUICK, epochs=2)
    whole = trained(data, tmp_path / "whole", two)
    trained(data, tmp_path / "halves", dataclasses.replace(two, epochs=1))
    halves = trained(data, tmp_path / "halves", two, resume=True)
    assert halves.loss_weights == whole.loss_weights
    for a, b in zip(whole.network.state_dict().values(), halves.network.state_dict().values(), strict=True):
        torch.testing.assert_close(a.float(), b.float(), atol=1e-5, rtol=1e-4)


def test_training_moves_the_loss_weights_and_leaves_checkpoints(data, tmp_path):
    module = trained(data, tmp_path, QUICK)
    assert (tmp_path / "last.ckpt").is_file()
    assert (tmp_path / "best.ckpt").is_file()
    assert module.loss_weights.x + module.loss_weights.y == pytest.approx(20.0)
    assert module.loss_weights.x != 10.0
    assert not module.network.training


@pytest.mark.parametrize("frozen", [False, True])
def test_frozen_statistics_stay(data, tmp_path, frozen):
    module = trained(data, tmp_path, dataclasses.replace(QUICK, frozen_statistics=frozen))
    means = [tensor for name, tensor in module.network.state_dict().items() if name.endswith("running_mean")]
    assert means
    assert all(not mean.any() for mean in means) == frozen


@pytest.mark.slow
def test_a_few_steps_on_two_frames_lower_the_loss(data):
    torch.manual_seed(0)
    module = StairNetTraining(0.25, QUICK)
    frames = GridFrames(StairDataset(data, "train"), None, size=256)
    batch = [torch.stack(tensors) for tensors in zip(frames[0], frames[1], strict=True)]
    module.log = module.log_dict = lambda *_args, **_kwargs: None  # outside of a trainer
    optimizer = torch.optim.Adam(module.parameters(), 3e-3)
    losses = []
    for _ in range(25):
        loss = module.training_step(tuple(batch), 0)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.5 * losses[0]


def test_evaluation_of_an_oracle_is_a_hundred_per_cent(data):
    frames = StairDataset(data, "train")
    truth = {frames[i].rgb.tobytes(): encode_grid(frames[i].lines) for i in range(len(frames))}

    def oracle(rgb, depth):
        grids = [truth.get(image.tobytes(), encode_grid(np.zeros((0, 4)))) for image in rgb]
        return np.stack([grid.cls for grid in grids]), np.stack([grid.loc for grid in grids])

    rows = {row["split"]: row for row in as_rows(evaluate_detector(oracle, frames), "oracle", 0.25)}
    assert rows["all"]["frames"] == len(frames)
    assert rows["all"]["iou"] == rows["all"]["accuracy"] == 100.0
    assert rows["depth_missing"]["iou"] == 100.0
    assert rows["colour_black"]["iou"] == 0.0  # the oracle knows no black image
    assert rows["day"]["frames"] + rows["night"]["frames"] == len(frames) if {"day", "night"} <= set(rows) else True


def test_splits_of_a_frame():
    empty = Sample(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, 4)), {"lighting": "day", "view": "none"})
    assert splits_of(empty) == ("all", "day", "negatives")
    public = Sample(np.zeros(0), np.zeros(0), np.zeros(1), np.zeros((1, 4)))
    assert splits_of(public) == ("all",)


def test_network_keeps_its_convolutions_dense_while_training_on_a_cpu():
    module = StairNetTraining(0.25, QUICK)
    assert isinstance(module.network, StairNetV2)
    flags = [m.dense for m in module.network.modules() if hasattr(m, "dense")]
    assert flags
    assert all(flag != torch.cuda.is_available() for flag in flags)


def test_flushing_denormals_ends_with_the_training():
    tiny = np.finfo(np.float64).tiny
    with pytest.raises(RuntimeError, match="broke"), _flushed_denormals():
        assert torch.tensor(tiny, dtype=torch.float64).div(2).item() == 0.0
        raise RuntimeError("broke off")
    assert np.float64(tiny) / 2 > 0.0


def test_a_damaged_checkpoint_is_named(data, tmp_path):
    (tmp_path / "last.ckpt").write_bytes(b"PK\x03\x04 cut short")
    with pytest.raises(ValueError, match=r"last.ckpt: damaged"):
        trained(data, tmp_path, QUICK, resume=True)


@pytest.mark.parametrize(("units", "precision"), [(True, "bf16-mixed"), (False, "32-true")])
def test_bfloat16_is_for_processors_that_have_it(monkeypatch: pytest.MonkeyPatch, units: bool, precision: str) -> None:
    monkeypatch.setattr(torch.ops.mkldnn, "_is_mkldnn_bf16_supported", lambda: units)
    assert _usable_precision("bf16-mixed", "cpu") == precision
    assert _usable_precision("32-true", "cpu") == "32-true"
    assert _usable_precision("bf16-mixed", "gpu") == "bf16-mixed"


def test_trust_is_a_part_of_the_loss_at_every_other_step(data):
    frames = GridFrames(StairDataset(data, "train"), None, size=256)
    batch = tuple(tensor[None] for tensor in frames[0])
    module = StairNetTraining(0.25, dataclasses.replace(QUICK, frozen_statistics=True, trust_weight=0.5))
    module.network.eval()
    logged: dict[str, float] = {}
    module.log = lambda name, value, **_kwargs: logged.update({name: float(value)})
    module.log_dict = lambda values: logged.update({name: float(value) for name, value in values.items()})
    totals = {}
    for step in (0, 1):
        logged.clear()
        module.training_step(batch, step)
        totals[step] = dict(logged)
    assert totals[1].keys() == totals[0].keys() - {"loss/trust"}
    assert totals[0]["loss/total"] == pytest.approx(totals[1]["loss/total"] + 2 * 0.5 * totals[0]["loss/trust"])


def test_the_selection_is_fitted_once_at_the_start_of_a_run(data, tmp_path, caplog):
    preset = dataclasses.replace(QUICK, frozen_statistics=True, trust_weight=0.1)
    with caplog.at_level("INFO"):
        trained(data, tmp_path, preset)
        assert caplog.text.count("of what to trust explained") == 1
        trained(data, tmp_path, dataclasses.replace(preset, epochs=2), resume=True)
        assert caplog.text.count("of what to trust explained") == 1
