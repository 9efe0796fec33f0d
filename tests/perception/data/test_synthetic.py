import json

import numpy as np
import pytest

from perception.data.stair_dataset import StairDataset
from perception.data.synthetic import FrameConfig, draw_frame, photograph
from perception.data.writer import DatasetPlan, complete, missing_frames, write_missing
from perception.estimator import check_gravity
from stair_env.common.transforms import look_at
from stair_env.intrinsics import Intrinsics
from stair_env.sampling import SceneSampler
from stair_env.scene.objects.distractors import DistractorSpec
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.stairs import StairSpec


def test_same_generator_same_frame():
    a, b = (draw_frame(np.random.default_rng(4), FrameConfig(), threads=1) for _ in range(2))
    np.testing.assert_array_equal(a.rgb, b.rgb)
    np.testing.assert_array_equal(a.depth_m, b.depth_m)
    np.testing.assert_array_equal(a.lines, b.lines)


def test_labels_lie_where_the_stairs_project():
    scene = Scene(SceneSpec(StairSpec("up", riser_height=0.15, tread_depth=0.3, num_steps=3)))
    pose = look_at([-1.2, 0.05, 0.8], [0.4, 0.0, 0.2])
    camera = Intrinsics(640, 480, 460.0, 460.0, 320.0, 240.0)
    frame = photograph(scene, pose, camera, np.random.default_rng(0), sensor_errors=False, threads=1)
    assert frame.view == "ascending"
    assert sorted(frame.kinds.tolist()) == [0, 0, 0, 1, 1, 1]
    projected = []
    for edge in scene.edges:
        points = (edge.endpoints - pose[:3, 3]) @ pose[:3, :3]
        uv = frame.intrinsics.project(points)
        projected.append(uv[np.argsort(uv[:, 0])].ravel())
    for line in frame.lines:
        slopes_and_heights = [
            np.abs(np.interp([line[0], line[2]], p[[0, 2]], p[[1, 3]]) - line[[1, 3]]).max() for p in projected
        ]
        assert min(slopes_and_heights) < 0.5


def test_view_and_gravity():
    scene = Scene(SceneSpec(StairSpec("down", num_steps=3)))
    camera = Intrinsics(640, 480, 460.0, 460.0, 320.0, 240.0)
    frame = photograph(scene, look_at([-1.0, 0, 1.1], [0.0, 0, 0.4]), camera, np.random.default_rng(0), threads=1)
    assert frame.view == "descending"
    level = photograph(scene, look_at([-1.0, 0, 1.1], [0.0, 0, 1.1]), camera, np.random.default_rng(0), threads=1)
    np.testing.assert_allclose(level.gravity, [0.0, -9.8, 0.0], atol=1e-9)
    assert check_gravity(frame.gravity)[2] < 0  # looking down: the lens sees less than the full pull, and backwards


def test_negatives_have_no_label():
    config = FrameConfig(sampler=SceneSampler(negatives=1.0, clutter=1.0))
    for seed in range(4):
        frame = draw_frame(np.random.default_rng(seed), config, threads=1)
        assert frame.view == "none"
        assert len(frame.lines) == 0


def test_clutter_cuts_lines_and_moves_none():
    stairs = StairSpec("up", riser_height=0.15, tread_depth=0.3, num_steps=4, flight_width=1.4)
    pose = look_at([-1.5, 0.05, 0.9], [0.5, 0.0, 0.3])
    camera = Intrinsics(640, 480, 460.0, 460.0, 320.0, 240.0)

    def lines(*things):
        scene = Scene(SceneSpec(stairs, distractors=things))
        return photograph(scene, pose, camera, np.random.default_rng(0), sensor_errors=False, threads=1).lines

    free = lines()
    hidden = lines(DistractorSpec("person", (0.15, 0.55, 0.15), size=(0.5, 0.5, 1.7)))
    lengths = [float((found[:, 2] - found[:, 0]).sum()) for found in (free, hidden)]
    assert 0.5 * lengths[0] < lengths[1] < 0.98 * lengths[0]
    for line in hidden:  # each lies on one of the lines that were there before
        off = [np.abs(np.interp(line[[0, 2]], old[[0, 2]], old[[1, 3]]) - line[[1, 3]]).max() for old in free]
        assert min(off) < 0.5


def test_written_set_reads_back_and_resumes(tmp_path):
    plan = DatasetPlan(tmp_path, {"train": 2, "test": 1}, seed=3)
    list(write_missing(plan))
    assert missing_frames(plan) == []
    drawn = draw_frame(plan.rng("train", 1), plan.config, threads=1)
    sample = StairDataset(tmp_path, "train")[1]
    assert np.abs(sample.rgb.astype(int) - drawn.rgb).mean() < 4.0  # jpg
    np.testing.assert_allclose(sample.depth_m, drawn.depth_m, atol=0.0006)
    np.testing.assert_allclose(sample.lines, drawn.lines, atol=0.006)
    assert sample.lighting == drawn.lighting
    assert sample.meta["fx"] == pytest.approx(drawn.intrinsics.fx)

    label = next((tmp_path / "train" / "labels").glob("000001_*.txt"))
    before = label.read_text()
    label.unlink()
    assert missing_frames(plan) == [("train", 1)]
    list(write_missing(plan))
    assert label.read_text() == before
    summary = complete(plan)
    assert summary["images"] == 6 == summary["day"] + summary["night"]
    assert json.loads((tmp_path / "dataset.json").read_text())["splits"]["test"]["images"] == 2


def test_another_set_is_not_mixed_in(tmp_path):
    list(write_missing(DatasetPlan(tmp_path, {"test": 1}, seed=0)))
    with pytest.raises(ValueError, match="another set"):
        list(write_missing(DatasetPlan(tmp_path, {"test": 1}, seed=1)))


def test_splits_and_seeds_draw_different_frames(tmp_path):
    draws = {
        DatasetPlan(tmp_path, seed=seed).rng(split, index).integers(2**62)
        for seed in range(2)
        for split in ("train", "val", "test")
        for index in range(3)
    }
    assert len(draws) == 18


def test_wrong_plans_are_named(tmp_path):
    with pytest.raises(ValueError, match="train, val, test"):
        DatasetPlan(tmp_path, {"dev": 3})
    with pytest.raises(ValueError, match="must not be negative"):
        DatasetPlan(tmp_path, {"val": -1})
    with pytest.raises(ValueError, match="mode_shares"):
        FrameConfig(mode_shares={"640x480": 0.5})
