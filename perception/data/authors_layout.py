"""A set of ours as the training code of the paper's authors reads it.

Their loader wants 8-bit depth in `depthes` and masks in `segmentation`, grey 0, 128 and 255. Their code names the
values and not what they mean; here 128 is a riser and 255 a tread of the flight. Labels stay as they are: their own
`label_transfer.py` makes cells of them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from perception.data.stair_dataset import (
    DEPTHS,
    GREY_LEVEL_M,
    IMAGE_SUFFIXES,
    DatasetError,
    decode_image,
    read_side_car,
)
from stair_env.common.constants import IMAGE_SIZE
from stair_env.common.files import atomic_path
from stair_env.intrinsics import Intrinsics
from stair_env.scene.shapes import build_stair_shapes
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.renderers.factory import make_renderer

SEGMENTATION = "segmentation"
BACKGROUND, RISER, TREAD = 0, 128, 255
ON_FACE_M = 0.004  # of a point from a tread's height; half of the least nosing that overhangs


def convert(folder: Path, grey_level_m: float = GREY_LEVEL_M) -> Iterator[str]:
    """Turn one split into the authors' layout; what is converted already stays.

    Args:
        folder: with images, depthes and labels, as `stair-env dataset` wrote it.
        grey_level_m: metres a level of the 8-bit depth; what is farther than 255 levels is 255.

    Yields:
        The name of each frame.

    Raises:
        DatasetError: a frame lacks its depth or a side-car with its scene.
    """
    (folder / SEGMENTATION).mkdir(exist_ok=True)
    for image in sorted(p for p in (folder / "images").iterdir() if p.suffix in IMAGE_SUFFIXES):
        depth_path, mask_path = (folder / name / f"{image.stem}.png" for name in (DEPTHS, SEGMENTATION))
        side_car = image.with_suffix(".json")
        if not mask_path.is_file():
            _write(mask_path, stair_mask(read_side_car(side_car), str(side_car)))
        depth = decode_image(depth_path, cv2.IMREAD_UNCHANGED)
        if depth.dtype == np.uint16:
            values = read_side_car(side_car)
            grey = np.clip(np.rint(depth * (values.get("depth_scale", 0.001) / grey_level_m)), 0, 255)
            with atomic_path(side_car) as temporary:
                temporary.write_text(json.dumps({**values, "grey_level_m": grey_level_m}), encoding="utf-8")
            _write(depth_path, grey.astype(np.uint8))
        yield image.stem


def stair_mask(side_car: dict[str, Any], where: str) -> np.ndarray:
    """uint8 (512, 512): BACKGROUND, RISER or TREAD at each pixel, drawn from the scene that a frame was rendered from.

    Args:
        side_car: of the frame.
        where: its file, for errors.

    Raises:
        DatasetError: it does not hold the scene.
    """
    try:
        spec = SceneSpec.from_json(json.dumps(side_car["scene"]))
        camera_to_world = np.array(side_car["camera_to_world"], np.float64).reshape(4, 4)
        model = Intrinsics(IMAGE_SIZE, IMAGE_SIZE, *(side_car[name] for name in ("fx", "fy", "cx", "cy")))
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{where}: does not say what was drawn: {error}") from None
    if spec.stairs is None:
        return np.full((IMAGE_SIZE, IMAGE_SIZE), BACKGROUND, np.uint8)
    scene = Scene(spec)
    renderer = make_renderer("raycast", scene)
    try:
        frame = renderer.render(model, camera_to_world)
    finally:
        renderer.close()
    count = len(build_stair_shapes(spec.stairs))
    stairs = (frame.segmentation >= 0) & (frame.segmentation < count) & (frame.depth_m > 0.0)
    points = model.rays() * frame.depth_m[..., None] @ camera_to_world[:3, :3].T + camera_to_world[:3, 3]
    levels = np.asarray(spec.stairs.profile().level_z, np.float64)
    on_level = np.abs(points[..., 2, None] - levels).min(axis=-1) < ON_FACE_M
    return np.where(stairs, np.where(on_level, TREAD, RISER), BACKGROUND).astype(np.uint8)


def _write(path: Path, image: np.ndarray) -> None:
    ok, data = cv2.imencode(".png", image)
    if not ok:
        raise OSError(f"{path}: cannot be encoded")
    with atomic_path(path) as temporary:
        temporary.write_bytes(data.tobytes())
