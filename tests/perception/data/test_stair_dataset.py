import json

import cv2
import numpy as np
import pytest

from perception.data.label_grid import LabelError
from perception.data.stair_dataset import GREY_LEVEL_M, DatasetError, StairDataset, read_depth


def write_frame(folder, stem="a", depth=None, label="0 10 20 300 40\n", side=512):
    for name in ("images", "depthes", "labels"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    rgb = np.full((side, side, 3), (200, 40, 10), np.uint8)
    cv2.imwrite(str(folder / "images" / f"{stem}.jpg"), rgb[..., ::-1])
    cv2.imwrite(
        str(folder / "depthes" / f"{stem}.png"), np.full((side, side), 1500, np.uint16) if depth is None else depth
    )
    (folder / "labels" / f"{stem}.txt").write_text(label)


def test_our_format_with_side_car(tmp_path):
    write_frame(tmp_path / "train")
    (tmp_path / "train" / "images" / "a.json").write_text(json.dumps({"lighting": "night", "view": "ascending"}))
    sample = StairDataset(tmp_path, "train")[0]
    np.testing.assert_allclose(sample.depth_m, 1.5)
    assert sample.rgb[0, 0, 0] > 150 > sample.rgb[0, 0, 2]  # red first
    assert (sample.lighting, sample.view) == ("night", "ascending")
    np.testing.assert_allclose(sample.lines, [[10, 20, 300, 40]])


@pytest.mark.parametrize("channels", [1, 3])
def test_public_format_has_grey_depth_and_no_side_car(tmp_path, channels):
    grey = np.full((512, 512), 51, np.uint8)
    write_frame(tmp_path, depth=grey if channels == 1 else np.repeat(grey[..., None], 3, -1), label="")
    sample = StairDataset(tmp_path)[0]
    np.testing.assert_allclose(sample.depth_m, 51 * GREY_LEVEL_M, rtol=1e-6)
    np.testing.assert_allclose(StairDataset(tmp_path, grey_level_m=0.03)[0].depth_m, 51 * 0.03, rtol=1e-6)
    assert (sample.lighting, sample.view, len(sample.lines)) == ("unknown", "none", 0)


@pytest.mark.parametrize("folder", ["images", "depthes", "labels"])
def test_missing_folder_is_named(tmp_path, folder):
    write_frame(tmp_path)
    for path in (tmp_path / folder).iterdir():
        path.unlink()
    (tmp_path / folder).rmdir()
    with pytest.raises(DatasetError, match=folder):
        StairDataset(tmp_path)


@pytest.mark.parametrize("twin", ["depthes/b.png", "labels/b.txt"])
def test_missing_twin_is_named(tmp_path, twin):
    write_frame(tmp_path)
    write_frame(tmp_path, "b")
    (tmp_path / twin).unlink()
    with pytest.raises(DatasetError, match=r"b\.jpg.*twin.*" + twin.replace(".", r"\.")):
        StairDataset(tmp_path)


@pytest.mark.parametrize("broken", ["images/a.jpg", "depthes/a.png"])
def test_unreadable_image_is_named(tmp_path, broken):
    write_frame(tmp_path)
    (tmp_path / broken).write_bytes(b"no image")
    with pytest.raises(DatasetError, match=broken.replace(".", r"\.")):
        StairDataset(tmp_path)[0]


def test_malformed_label_names_file_and_line(tmp_path):
    write_frame(tmp_path, label="0 1 2 3 4\n7 1 2 3 4\n")
    with pytest.raises(LabelError, match=r"a\.txt:2"):
        StairDataset(tmp_path)[0]


def test_wrong_size_and_broken_side_car_are_named(tmp_path):
    write_frame(tmp_path, side=256)
    with pytest.raises(DatasetError, match=r"a\.jpg.*256x256"):
        StairDataset(tmp_path)[0]
    write_frame(tmp_path)
    (tmp_path / "images" / "a.json").write_text("[1, 2]")
    with pytest.raises(DatasetError, match=r"a\.json"):
        StairDataset(tmp_path)[0]


def test_depth_of_another_type_is_refused(tmp_path):
    path = tmp_path / "depth.tiff"
    cv2.imwrite(str(path), np.ones((4, 4), np.float32))
    with pytest.raises(DatasetError, match="float32"):
        read_depth(path)


def test_empty_set_is_named(tmp_path):
    for name in ("images", "depthes", "labels"):
        (tmp_path / name).mkdir()
    with pytest.raises(DatasetError, match="images"):
        StairDataset(tmp_path)


def test_matched_depth_beside_the_modelled(tmp_path):
    write_frame(tmp_path)
    assert StairDataset(tmp_path).matched_folders == ()
    (tmp_path / "depthes_stereo1").mkdir()
    cv2.imwrite(str(tmp_path / "depthes_stereo1" / "a.png"), np.full((512, 512), 2500, np.uint16))
    frames = StairDataset(tmp_path)
    assert frames.matched_folders == ("depthes_stereo1",)
    np.testing.assert_allclose(frames[0].depth_m, 1.5)
    np.testing.assert_allclose(frames.frame(0, "depthes_stereo1").depth_m, 2.5)
    np.testing.assert_allclose(frames.depth(0, "depthes_stereo1"), 2.5)
