"""Depth as an active stereo camera measures it: two infrared images, matched, filtered, aligned to colour.

`stair_env.sensors.camera.depth_error` models the errors of such a camera and is fast; here they come about as in the
device. Repeated edges are mistaken for each other, creases are rounded by the matching window, sunlight washes the
pattern out, and what one imager does not see has no depth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from stair_env.intrinsics import D435I_COLOUR_OFFSET_M, Intrinsics
from stair_env.sensors.camera.stereo.config import StereoConfig

if TYPE_CHECKING:
    from stair_env.scene.shapes import Shape
    from stair_env.sensors.camera.renderers.base import Renderer
    from stair_env.sensors.camera.stereo.infrared import Imager

DEPTH_UNIT_M = 0.001
PATTERNS = 64  # different projectors
MARGIN_PX = 24  # matched around what the colour image shows: half a window and what a smooth path needs to settle


class StereoDepth:
    """The depth half of a D435i, by rendering and matching.

    Args:
        config: the camera.
    """

    def __init__(self, config: StereoConfig | None = None) -> None:
        from stair_env.sensors.camera.stereo.matching import make_matcher

        self.config = config if config is not None else StereoConfig()
        self._matcher = make_matcher(self.config)
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Take another unit into another light: draw its imagers, its projector and the ambient infrared light."""
        from stair_env.sensors.camera.stereo.filters import TemporalFilter

        low, high = self.config.ambient_gain
        self._ambient_gain = math.exp(rng.uniform(math.log(low), math.log(high)))
        self._pattern_seed = int(rng.integers(PATTERNS))
        self._imager_seed = int(rng.integers(2**63))
        self._imagers: tuple[Imager, ...] = ()
        self._temporal = TemporalFilter(
            self.config.temporal_alpha, self.config.spatial_delta_px, self.config.persistency
        )

    def infrared_pair(
        self,
        renderer: Renderer,
        colour_to_world: np.ndarray,
        rng: np.random.Generator,
        moving: Sequence[Shape] = (),
    ) -> tuple[np.ndarray, np.ndarray]:
        """What the two imagers record.

        Args:
            renderer: draws the scene.
            colour_to_world: (4, 4) pose of the colour camera, metres.
            rng: of the noise.
            moving: solids besides the renderer's scene.

        Returns:
            Left and right image, uint8 (H, W).
        """
        from stair_env.sensors.camera.stereo.infrared import Imager, dot_pattern

        config = self.config
        if not self._imagers:  # drawn when needed: a camera may be reset many times before it takes a picture
            unit = np.random.default_rng(self._imager_seed)
            self._imagers = tuple(Imager.draw(config, is_right, unit) for is_right in (False, True))
        pattern = dot_pattern(config.dots, config.dot_width_px, self._pattern_seed)
        images = []
        for imager, x_m in zip(self._imagers, (D435I_COLOUR_OFFSET_M, D435I_COLOUR_OFFSET_M + config.baseline_m)):
            pose = np.array(colour_to_world, dtype=np.float64)
            pose[:3, 3] += x_m * pose[:3, 0]
            frame = renderer.render(config.intrinsics, pose, moving=moving)
            images.append(imager.expose(frame, pattern, config, self._ambient_gain, rng))
        return images[0], images[1]

    def depth_of_pair(self, left: np.ndarray, right: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
        """Match a pair, filter it, and align its depth to the colour image.

        Args:
            left, right: uint8 (H, W) of the configuration's mode.
            intrinsics: of the colour image.

        Returns:
            float32 (h, w) of the colour image, metres, 0 = no reading.
        """
        from stair_env.sensors.camera.stereo import kernels
        from stair_env.sensors.camera.stereo.filters import post_process
        from stair_env.sensors.camera.stereo.matching import match

        config, k = self.config, self.config.intrinsics
        rows, columns = self._needed(intrinsics)
        matched = match(left[rows], right[rows], config, self._matcher, columns)
        disparity = post_process(matched, config, self._temporal)
        depth = np.empty_like(disparity)
        kernels.to_depth(
            disparity, k.fx * config.baseline_m, DEPTH_UNIT_M, config.min_range_m, config.max_range_m, depth
        )
        source = np.array([k.fx, k.fy, k.cx - columns.start, k.cy - rows.start]) / config.decimation
        target = np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy])
        aligned = np.empty((intrinsics.height, intrinsics.width), np.float32)
        kernels.align(depth, source, D435I_COLOUR_OFFSET_M, target, aligned)
        return aligned

    def _needed(self, intrinsics: Intrinsics) -> tuple[slice, slice]:
        """Rows and columns of the left image that the colour image can show, with room for windows and filters."""
        k, config = self.config.intrinsics, self.config
        parallax = k.fx * D435I_COLOUR_OFFSET_M / config.min_range_m if config.min_range_m > 0.0 else k.width
        left, right = (k.fx * (u - intrinsics.cx) / intrinsics.fx + k.cx for u in (0.0, float(intrinsics.width)))
        top, bottom = (k.fy * (v - intrinsics.cy) / intrinsics.fy + k.cy for v in (0.0, float(intrinsics.height)))
        return (
            slice(max(int(top) - MARGIN_PX, 0), min(int(bottom) + MARGIN_PX, k.height)),
            slice(max(int(left - parallax) - MARGIN_PX, 0), min(int(right) + MARGIN_PX, k.width)),
        )

    def measure(
        self,
        renderer: Renderer,
        colour_to_world: np.ndarray,
        intrinsics: Intrinsics,
        rng: np.random.Generator,
        moving: Sequence[Shape] = (),
    ) -> np.ndarray:
        """One depth frame, aligned to colour.

        Args:
            renderer: draws the scene.
            colour_to_world: (4, 4) pose of the colour camera.
            intrinsics: of the colour image.
            rng: of the noise.
            moving: solids besides the renderer's scene.

        Returns:
            float32 (H, W), distance along the optical axis, metres, 0 = no reading.
        """
        left, right = self.infrared_pair(renderer, colour_to_world, rng, moving)
        return self.depth_of_pair(left, right, intrinsics)
