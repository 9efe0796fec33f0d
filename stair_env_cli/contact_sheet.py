"""Pictures of random scenes for human eyes: colour, depth in false colours, labels over colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stair_env.intrinsics import Intrinsics
from stair_env.sampling import Scene, SceneSpec, sample_camera_pose

if TYPE_CHECKING:  # both load what `import stair_env` must not
    from stair_env.sensors.camera.labels import LineLabel

LABEL_COLOURS = {"convex": (255, 70, 40), "concave": (40, 200, 255)}  # RGB
DEPTH_SPAN_M = (0.3, 4.0)
MARGIN_PX = 4
BACKGROUND = 24
LINE_WIDTH_PX = 2
JPEG_QUALITY = 88


@dataclass(frozen=True, eq=False)
class View:
    """One scene from one viewpoint.

    Attributes:
        spec: the scene.
        camera_to_world: (4, 4) pose of the optical frame.
        intrinsics: of the images.
        rgb: uint8 (H, W, 3).
        depth_m: float32 (H, W), 0 = no reading.
        labels: visible stair lines, pixels.
    """

    spec: SceneSpec
    camera_to_world: np.ndarray
    intrinsics: Intrinsics
    rgb: np.ndarray
    depth_m: np.ndarray
    labels: tuple[LineLabel, ...]


def draw_view(
    spec: SceneSpec,
    intrinsics: Intrinsics,
    rng: np.random.Generator,
    *,
    sensor: bool = False,
    camera_to_world: np.ndarray | None = None,
) -> View:
    """Render a scene from a random viewpoint.

    Args:
        spec: the scene.
        intrinsics: of the images to draw.
        rng: draws the viewpoint and the sensor's errors.
        sensor: add the D435i's errors to colour and depth.
        camera_to_world: (4, 4) viewpoint; drawn when None.
    """
    from stair_env.sensors.camera.still import draw_device, draw_labelled

    scene = Scene(spec)
    pose = sample_camera_pose(spec, rng, scene=scene) if camera_to_world is None else camera_to_world
    frame, labels = draw_labelled(scene, intrinsics, pose)
    rgb, depth_m = frame.rgb, frame.depth_m
    if sensor:
        depth_error, colour_error = draw_device(rng)
        rgb = colour_error.apply(frame.rgb, rng)
        depth_m = depth_error.apply(frame.depth_m, frame.rgb, intrinsics, rng)
    return View(spec, pose, intrinsics, rgb, depth_m, tuple(labels))


def false_colours(depth_m: np.ndarray) -> np.ndarray:
    """Near is red, far is blue, no reading is black.

    Args:
        depth_m: (H, W) metres, 0 = no reading.

    Returns:
        uint8 (H, W, 3).
    """
    import cv2

    near, far = (1.0 / limit for limit in DEPTH_SPAN_M)
    inverse = 1.0 / np.maximum(depth_m, 1e-3)
    level = np.clip((inverse - far) / (near - far), 0.0, 1.0) ** 0.6
    coloured = cv2.applyColorMap((level * 255).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1].copy()
    coloured[depth_m <= 0.0] = 0
    return coloured


def draw_labels(rgb: np.ndarray, labels: Sequence[LineLabel], width_px: int = LINE_WIDTH_PX) -> np.ndarray:
    """Nosings orange, inner edges blue, over a copy of the picture."""
    import cv2

    picture = np.ascontiguousarray(rgb)
    picture = picture.copy()
    for label in labels:
        start, end = ((round(x * 16), round(y * 16)) for x, y in ((label.x1, label.y1), (label.x2, label.y2)))
        cv2.line(picture, start, end, LABEL_COLOURS[label.kind], width_px, cv2.LINE_AA, shift=4)
    return picture


def contact_sheet(views: Sequence[View], columns: int = 2, tile_width_px: int = 320) -> np.ndarray:
    """All views on one sheet, three pictures each: colour, depth, labels over colour.

    Args:
        views: at least one.
        columns: views side by side.
        tile_width_px: width of one picture on the sheet.

    Returns:
        uint8 (H, W, 3).

    Raises:
        ValueError: there are no views.
    """
    if not views:
        raise ValueError("views is empty, a sheet needs at least one")
    import cv2

    strips = []
    for view in views:
        height = round(tile_width_px * view.intrinsics.height / view.intrinsics.width)
        # Lines are drawn at the pictures' own size, so that they shrink with them.
        line = max(1, round(LINE_WIDTH_PX * view.intrinsics.width / tile_width_px))
        pictures = (view.rgb, false_colours(view.depth_m), draw_labels(view.rgb, view.labels, line))
        small = [cv2.resize(picture, (tile_width_px, height), interpolation=cv2.INTER_AREA) for picture in pictures]
        strips.append(np.hstack([_framed(picture) for picture in small]))
    rows = [strips[start : start + columns] for start in range(0, len(strips), columns)]
    width = max(sum(strip.shape[1] for strip in row) for row in rows)
    height = max(strip.shape[0] for strip in strips)
    sheet = np.full((height * len(rows), width, 3), BACKGROUND, np.uint8)
    for r, row in enumerate(rows):
        x = 0
        for strip in row:
            sheet[r * height : r * height + strip.shape[0], x : x + strip.shape[1]] = strip
            x += strip.shape[1]
    return sheet


def _framed(picture: np.ndarray) -> np.ndarray:
    margin = MARGIN_PX // 2
    return np.pad(picture, ((margin, margin), (margin, margin), (0, 0)), constant_values=BACKGROUND)


def check_picture_path(path: Path | str) -> str:
    """Return the file's ending.

    Raises:
        ValueError: no picture can be written there.
    """
    ending = Path(path).suffix.lower()
    if ending not in (".png", ".jpg", ".jpeg"):
        raise ValueError(f"picture {str(path)!r} must end in .png, .jpg or .jpeg")
    if Path(path).is_dir():
        raise ValueError(f"picture {str(path)!r} is a directory")
    return ending


def write_picture(path: Path | str, rgb: np.ndarray) -> None:
    """Write a PNG or JPEG, by the file's ending, whole or not at all.

    Raises:
        ValueError: another ending, or a folder.
    """
    import cv2

    from stair_env.common.images import write_image

    ending = check_picture_path(path)
    write_image(path, rgb[..., ::-1], () if ending == ".png" else (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))
