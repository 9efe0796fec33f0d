"""Image files by any name, and what is no image."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from stair_env.common.images import read_image, write_image

IMAGE = np.random.default_rng(0).integers(0, 255, (9, 7, 3)).astype(np.uint8)


@pytest.mark.parametrize("name", ["plain.png", "雪 é.png", os.fsdecode(b"tr\xe9ppe.png")])
def test_any_name_is_written_and_read(name: str, tmp_path: Path) -> None:
    write_image(tmp_path / "new" / name, IMAGE)
    assert np.array_equal(read_image(tmp_path / "new" / name, cv2.IMREAD_COLOR), IMAGE)


@pytest.mark.parametrize("content", [b"", b"no image", b"\x89PNG\r\n\x1a\n" + b"\xff" * 50])
def test_what_is_no_image_is_told(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.png"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"x.png: cannot be read as an image"):
        read_image(path, cv2.IMREAD_COLOR)


def test_an_image_that_is_cut_is_told_or_read_in_part(tmp_path: Path) -> None:
    path = tmp_path / "x.png"
    write_image(path, IMAGE)
    content = path.read_bytes()
    for tenth in range(10):
        path.write_bytes(content[: len(content) * tenth // 10])
        try:
            assert read_image(path, cv2.IMREAD_COLOR).shape == IMAGE.shape
        except ValueError as error:
            assert "x.png" in str(error)
