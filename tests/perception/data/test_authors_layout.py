"""The authors' loader finds 8-bit depth and masks whose faces lie where the staircase has them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from perception.data.authors_layout import BACKGROUND, RISER, TREAD, convert, stair_mask
from perception.data.stair_dataset import GREY_LEVEL_M, DatasetError, StairDataset
from perception.data.synthetic import FrameConfig, draw_frame
from perception.data.writer import write_frame
from stair_env.sampling import SceneSampler


@pytest.fixture(scope="module")
def split(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("authors")
    config = FrameConfig(sampler=SceneSampler(negatives=0.0), sensor_errors=False)
    for index in range(2):
        write_frame(root, f"{index:06d}_day", draw_frame(np.random.default_rng(index), config, threads=1))
    return root


def test_a_set_becomes_theirs_once(split: Path) -> None:
    before = StairDataset(split)[0]
    names = list(convert(split))
    assert names == ["000000_day", "000001_day"]
    masks = [cv2.imread(str(split / "segmentation" / f"{name}.png"), cv2.IMREAD_UNCHANGED) for name in names]
    for mask in masks:
        assert mask.dtype == np.uint8 and mask.shape == (512, 512)
        assert set(np.unique(mask)) <= {BACKGROUND, RISER, TREAD} and (mask > 0).mean() > 0.02
    depth = cv2.imread(str(split / "depthes" / "000000_day.png"), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint8
    after = StairDataset(split)[0]
    near = (before.depth_m > 0) & (before.depth_m < 255 * GREY_LEVEL_M)
    assert np.abs(after.depth_m - before.depth_m)[near].max() <= GREY_LEVEL_M / 2 + 1e-3
    assert after.meta["grey_level_m"] == GREY_LEVEL_M
    stamps = [path.stat().st_mtime_ns for path in sorted(split.rglob("*.png"))]
    assert list(convert(split)) == names
    assert stamps == [path.stat().st_mtime_ns for path in sorted(split.rglob("*.png"))]


def test_faces_meet_in_the_labelled_lines(split: Path) -> None:
    """On either side of a line on the flight the mask changes, or one of the sides is something else."""
    sample = StairDataset(split)[0]
    mask = stair_mask(sample.meta, "a").astype(int)
    changes = 0
    for x1, y1, x2, y2 in sample.lines:
        x, y = round((x1 + x2) / 2), round((y1 + y2) / 2)
        changes += len(set(mask[max(y - 4, 0) : y + 5, x])) > 1
    assert changes >= 0.7 * len(sample.lines)


def test_a_scene_without_stairs_is_background_and_a_side_car_without_scene_is_named(split: Path) -> None:
    meta = json.loads((split / "images" / "000000_day.json").read_text())
    meta["scene"]["stairs"] = None
    assert not stair_mask(meta, "a").any()
    with pytest.raises(DatasetError, match=r"b\.json.*scene"):
        stair_mask({}, "b.json")
