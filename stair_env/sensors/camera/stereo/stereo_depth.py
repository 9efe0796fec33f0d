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

DEPTH_UNIT_M = 0.001
PATTERNS = 64  # different projectors


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
        from stair_env.sensors.camera.stereo.infrared import Imager

        low, high = self.config.ambient_gain
        self._ambient_gain = math.exp(rng.uniform(math.log(low), math.log(high)))
        self._pattern_seed = int(rng.integers(PATTERNS))
        self._imagers = tuple(Imager.draw(self.config, is_right, rng) for is_right in (False, True))
        self._temporal = TemporalFilter(self.config.temporal_alpha, self.config.spatial_delta_px)

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
        from stair_env.sensors.camera.stereo.infrared import dot_pattern

        config = self.config
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
        disparity = post_process(match(left, right, config, self._matcher), config, self._temporal)
        depth = np.where(disparity > 0.0, k.fx * config.baseline_m / np.maximum(disparity, np.float32(1e-3)), 0.0)
        depth = np.round(depth / DEPTH_UNIT_M) * DEPTH_UNIT_M
        depth[(depth < config.min_range_m) | (depth > config.max_range_m)] = 0.0
        source = np.array([k.fx, k.fy, k.cx, k.cy]) / config.decimation
        target = np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy])
        aligned = np.empty((intrinsics.height, intrinsics.width), np.float32)
        kernels.align(depth.astype(np.float32), source, D435I_COLOUR_OFFSET_M, target, aligned)
        return aligned

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
