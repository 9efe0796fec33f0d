"""Folders and files: every kind of depth image, pairs by name, time stamps, and errors that name the file."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from perception.sources.depth_files import read_depth_file
from perception.sources.folders import read_stamped
from perception.sources.opening import SourceOptions, open_source
from perception.sources.preparation import prepared
from perception.sources.source import SourceError

METRES = np.linspace(0.4, 4.0, 48 * 64, dtype=np.float32).reshape(48, 64)


@pytest.mark.parametrize("kind", ["png", "tiff", "pgm", "npy", "float.npy", "float.tiff", "float.exr"])
def test_every_kind_of_depth(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"d.{kind}"
    image = METRES if kind.startswith("float") else np.rint(1000 * METRES).astype(np.uint16)
    if kind.endswith("npy"):
        np.save(path, image)
    elif kind.endswith("exr"):
        exr = pytest.importorskip("OpenEXR")
        exr.File({"type": exr.scanlineimage}, {"Z": image}).write(str(path))
    else:
        assert cv2.imwrite(str(path), image)
    read = read_depth_file(path)
    assert read.depth_m is not None and read.depth_m.dtype == np.float32 and read.hints == ()
    np.testing.assert_allclose(read.depth_m, METRES, atol=6e-4)


def test_what_is_no_depth_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(b"nothing")
    np.save(tmp_path / "b.npy", np.array(["x"]))
    for name in ("c.png", "e.exr"):
        (tmp_path / name).write_bytes(b"nothing")
    for name in ("a.npy", "b.npy", "c.png", "d.png", "e.exr", "f.exr"):
        with pytest.raises(ValueError, match=name.replace(".", r"\.")):
            read_depth_file(tmp_path / name)


def images(folder: Path, names: list[str]) -> None:
    folder.mkdir(parents=True)
    for index, name in enumerate(names):
        value = np.random.default_rng(index).integers(0, 255, (48, 64, 3), np.uint8)
        image = np.rint(1000 * METRES).astype(np.uint16) if "depth" in folder.name else value
        assert cv2.imwrite(str(folder / name), image)


@pytest.mark.parametrize("colour, depth", [("images", "depthes"), ("rgb", "depth")])
def test_a_folder_with_colour_and_depth(colour: str, depth: str, tmp_path: Path) -> None:
    images(tmp_path / colour, ["b.png", "a.png"])
    images(tmp_path / depth, ["a.png", "b.png"])
    frames = list(prepared(open_source([tmp_path])))
    assert [frame.name for frame in frames] == ["a", "b"]
    assert all(frame.depth_m is not None for frame in frames)
    assert len(list(open_source([tmp_path / colour, tmp_path / depth]))) == 2
    (tmp_path / depth / "b.png").unlink()
    with pytest.raises(SourceError, match=r"lacks a depth image named b"):
        open_source([tmp_path])


def test_colour_alone(tmp_path: Path) -> None:
    images(tmp_path / "photos", ["a.png"])
    for words in ([tmp_path / "photos"], [tmp_path / "photos" / "a.png"]):
        frame = next(prepared(open_source(words)))
        assert frame.depth_m is None and frame.gravity is None and frame.gravity_source == "none"


def tum(folder: Path) -> Path:
    images(folder / "rgb", ["a.png", "b.png", "c.png"])
    images(folder / "depth", ["a.png", "c.png"])
    (folder / "rgb.txt").write_text("# time file\n1.00 rgb/a.png\n1.10 rgb/b.png\n1.20 rgb/c.png\n")
    (folder / "depth.txt").write_text("1.01 depth/a.png\n1.21 depth/c.png\n")
    (folder / "accelerometer.txt").write_text("".join(f"{0.9 + 0.01 * k:.2f} 0.0 -9.7 0.5\n" for k in range(30)))
    return folder


def test_a_tum_folder(tmp_path: Path) -> None:
    frames = list(prepared(open_source([tum(tmp_path / "set")])))
    assert [frame.depth_m is not None for frame in frames] == [True, False, True]  # nothing within 20 ms of b
    np.testing.assert_allclose(frames[0].depth_m, METRES / 5.0, atol=2e-4)  # the format's unit
    assert [frame.gravity_source for frame in frames] == ["imu"] * 3
    (tmp_path / "set" / "camera.json").write_text(
        json.dumps({"fx": 60.0, "fy": 60.0, "ppx": 31.5, "ppy": 23.5, "depth_scale": 0.001})
    )
    frame = next(prepared(open_source([tmp_path / "set"])))
    assert (frame.intrinsics.cx, frame.intrinsics.cy) == (32.0, 24.0)
    np.testing.assert_allclose(frame.depth_m, METRES, atol=6e-4)


@pytest.mark.parametrize("text", ["x a.png", "1.0", "2.0 a.png\n1.0 b.png", "nan a.png"])
def test_a_list_that_is_none_is_named(text: str, tmp_path: Path) -> None:
    path = tmp_path / "rgb.txt"
    path.write_text(text)
    with pytest.raises(SourceError, match=r"rgb\.txt:\d"):
        read_stamped(path)


def test_what_is_not_there_is_named(tmp_path: Path) -> None:
    for words in (["nowhere"], [str(tmp_path), "nowhere"], []):
        with pytest.raises(SourceError):
            open_source(words)
    with pytest.raises(SourceError, match="holds no image"):
        open_source([tmp_path])


def test_the_simulated_camera_is_a_source() -> None:
    source = open_source(["simulated"], SourceOptions(frames=3))
    frames = list(prepared(source))
    source.close()
    assert len(frames) == 3 == len({frame.time_s for frame in frames})
    assert frames[0].gravity_source == "imu" and frames[0].depth_m is not None
    assert frames[0].gravity is not None and frames[0].gravity[1] < -8.0
