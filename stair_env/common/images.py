"""Image files by any name: OpenCV's own readers crash on names that are not UTF-8."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stair_env.common.files import atomic_path


def read_image(path: Path | str, flags: int) -> np.ndarray:
    """Decode an image file.

    Args:
        path: of the file.
        flags: of `cv2.imdecode`.

    Raises:
        OSError: the file cannot be read.
        ValueError: it holds no image.
    """
    import cv2

    data = np.frombuffer(Path(path).read_bytes(), np.uint8)
    try:
        image = cv2.imdecode(data, flags) if len(data) else None
    except cv2.error:  # a size that no picture has
        image = None
    if image is None:
        raise ValueError(f"{path}: cannot be read as an image")
    return np.asarray(image)


def write_image(path: Path | str, image: np.ndarray, options: tuple[int, ...] = ()) -> None:
    """Encode an image by the file's ending and write it, whole or not at all.

    Args:
        path: of the file; missing folders are made.
        image: as `cv2.imencode` takes it, colour in the order blue, green, red.
        options: of `cv2.imencode`.

    Raises:
        OSError: the file cannot be written.
        ValueError: the image cannot be encoded.
    """
    import cv2

    done, data = cv2.imencode(Path(path).suffix, np.ascontiguousarray(image), list(options))
    if not done:
        raise ValueError(f"cannot encode a picture of shape {image.shape} as {Path(path).suffix}")
    with atomic_path(path) as temporary:
        temporary.write_bytes(data.tobytes())
