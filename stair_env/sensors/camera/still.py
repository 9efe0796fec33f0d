"""Single frames: a scene from one viewpoint with its labels, and the errors of one device that was drawn at random."""

from __future__ import annotations

import numpy as np

from stair_env.intrinsics import Intrinsics
from stair_env.scene.spec import Scene
from stair_env.sensors.camera.colour_error import ColourErrorModel
from stair_env.sensors.camera.depth_error import DepthErrorConfig, DepthErrorModel
from stair_env.sensors.camera.labels import MIN_GAP_PX, MIN_LENGTH_PX, LineLabel, visible_edges
from stair_env.sensors.camera.renderers.base import Frame
from stair_env.sensors.camera.renderers.factory import make_renderer
from stair_env.sensors.camera.stereo import StereoConfig, StereoDepth


def draw_labelled(
    scene: Scene,
    intrinsics: Intrinsics,
    camera_to_world: np.ndarray,
    *,
    label_scale: float = 1.0,
    threads: int | None = None,
) -> tuple[Frame, list[LineLabel]]:
    """Render one scene from one viewpoint and find its visible stair lines.

    Args:
        scene: what to draw.
        intrinsics: of the image.
        camera_to_world: (4, 4) pose of the optical frame.
        label_scale: factor on the least length of a line and the least gap between two, which are meant for images
            of 512 pixels.
        threads: of the ray caster; None for its default.

    Returns:
        The exact frame, and the lines in its pixels.
    """
    renderer = make_renderer("raycast", scene, threads=threads)
    try:
        frame = renderer.render(intrinsics, camera_to_world)
    finally:
        renderer.close()
    labels = visible_edges(
        scene.edges,
        intrinsics,
        camera_to_world,
        frame,
        min_length_px=MIN_LENGTH_PX * label_scale,
        min_gap_px=MIN_GAP_PX * label_scale,
    )
    return frame, labels


def draw_matched(
    scene: Scene,
    intrinsics: Intrinsics,
    camera_to_world: np.ndarray,
    rng: np.random.Generator,
    count: int = 1,
    *,
    config: StereoConfig | None = None,
    threads: int | None = None,
) -> list[np.ndarray]:
    """Depth of one scene from one viewpoint as stereo cameras drawn at random match it.

    Args:
        scene: what to draw.
        intrinsics: of the colour image that depth is aligned to.
        camera_to_world: (4, 4) pose of the colour camera.
        rng: draws the cameras, their light and their noise.
        count: how many cameras.
        config: of all of them; drawn for each (`StereoConfig.random`) when None.
        threads: of the ray caster; None for its default.

    Returns:
        float32 (H, W) each, metres, 0 = no reading.
    """
    if count == 0:
        return []
    renderer, depths = make_renderer("raycast", scene, threads=threads), []
    try:
        for _ in range(count):
            sensor = StereoDepth(config if config is not None else StereoConfig.random(rng))
            sensor.reset(rng)
            depths.append(sensor.measure(renderer, camera_to_world, intrinsics, rng))
    finally:
        renderer.close()
    return depths


def draw_device(
    rng: np.random.Generator, depth: DepthErrorConfig | None = None
) -> tuple[DepthErrorModel, ColourErrorModel]:
    """Draw the errors of one device.

    Args:
        rng: the source of all chance.
        depth: of what devices; the D435i's when None.
    """
    depth_model, colour_model = DepthErrorModel(depth or DepthErrorConfig()), ColourErrorModel()
    depth_model.reset(rng)
    colour_model.reset(rng)
    return depth_model, colour_model
