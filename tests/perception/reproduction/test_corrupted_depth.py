import numpy as np
import pytest

from perception.data.stair_dataset import StairDataset
from perception.data.synthetic import FrameConfig
from perception.data.writer import DatasetPlan, complete, write_missing
from perception.inference.backends import OnnxBackend
from perception.inference.weights import load_network
from perception.reproduction.corrupted_depth import (
    CORRUPTIONS,
    NO_COLOUR,
    corrupted,
    draw_colour_weights,
    look_at_selection,
    mean_weights,
    names_for,
    score_corrupted,
)


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    root = tmp_path_factory.mktemp("set")
    plan = DatasetPlan(root, {"test": 3}, seed=3, config=FrameConfig(stereo_variants=1))
    assert len(list(write_missing(plan))) == 3
    complete(plan)
    return StairDataset(root, "test")


def test_each_corruption_does_what_its_name_says(frames):
    depth = frames[0].depth_m
    samples = {name: corrupted(frames, 0, name) for name in names_for(frames)}
    without = samples.pop(NO_COLOUR)
    assert not without.rgb.any()
    np.testing.assert_array_equal(without.depth_m, depth)
    for sample in samples.values():
        np.testing.assert_array_equal(sample.rgb, frames[0].rgb)
    made = {name: sample.depth_m for name, sample in samples.items()}
    np.testing.assert_array_equal(made["as drawn"], depth)
    np.testing.assert_array_equal(made["matched"], frames.depth(0, "depthes_stereo1"))
    np.testing.assert_array_equal(made["another frame's"], frames.depth(1))
    assert not made["none"].any()
    assert (made["constant"] == 2.0).all()
    seen = depth > 0.0
    for share, name in ((0.05, "single holes 5 %"), (0.2, "single holes 20 %")):
        assert (made[name] == 0.0)[seen].mean() == pytest.approx(share, abs=0.01)
    moved = [np.abs(1.0 / made[f"blurred {s} px"][seen] - 1.0 / depth[seen]).mean() for s in (4, 8, 16)]
    assert 0.0 < moved[0] < moved[1] < moved[2]
    assert (made["blurred 8 px"] > 0.0)[seen].all()


def test_without_matched_depth_that_row_is_left_out(frames, tmp_path):
    assert "matched" in names_for(frames)
    plan = DatasetPlan(tmp_path, {"test": 1}, seed=3)
    list(write_missing(plan))
    assert "matched" not in names_for(StairDataset(tmp_path, "test"))


def test_rows_add_up_over_light(frames):
    rows = score_corrupted(OnnxBackend(0.25), frames, 0.25)
    assert {row["split"] for row in rows} == {*CORRUPTIONS, NO_COLOUR}
    for name in (*CORRUPTIONS, NO_COLOUR):
        counted = {row["lighting"]: row["frames"] for row in rows if row["split"] == name}
        assert counted.pop("all") == sum(counted.values()) == 3


def test_weights_of_the_modalities_what_they_are_worth_and_their_figure(frames, tmp_path):
    network = load_network(0.25).eval()
    weights, rows = look_at_selection(network, frames, range(3))
    found = {0.25: weights}
    assert all(0.0 <= row["colour_weight"] <= 1.0 for row in mean_weights(found))
    assert sum(len(values) for values in weights["none"].values()) == 3
    scored = {row["split"]: row["iou"] for row in score_corrupted(OnnxBackend(0.25), frames, 0.25)
              if row["lighting"] == "all"}  # fmt: skip
    assert {row["split"]: row["iou"] for row in rows} == pytest.approx(scored, abs=0.5), "its own weights"
    assert rows[0]["split"] == "as drawn" and rows[0]["iou"] == rows[0]["iou_held"]
    assert any(row["iou"] != row["iou_held"] for row in rows), "holding the weights must change something"
    draw_colour_weights(found).savefig(tmp_path / "weights.png")
    assert (tmp_path / "weights.png").stat().st_size > 1000
