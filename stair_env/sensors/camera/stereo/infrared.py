"""What an infrared imager of an active stereo camera records: ambient light, projected dots, noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from stair_env.intrinsics import Intrinsics
from stair_env.sensors.camera.noise_tiles import TILE_SIDE_PX, gaussian_tile
from stair_env.sensors.camera.renderers.base import Frame
from stair_env.sensors.camera.stereo.config import StereoConfig

PROJECTOR_X_SHARE = 0.58  # of the baseline: the projector sits between the imagers, nearer to the right one
TABLE_PX = 900.0  # pixels of the pattern's table per unit of tangent, twice what an imager resolves
TABLE_SIDES_PX = (1260, 2160)  # rows and columns: 70 x 100 degrees, more than the imagers see
REFERENCE_FOCAL_PX = 447.0  # of the imager whose pixels `StereoConfig.dot_width_px` counts
TARGET_LEVEL = 0.32  # mean brightness that automatic exposure aims at, of 1
LOWEST_REFLECTANCE = 0.12  # of black cloth or rubber in near infrared
DARK_SCENE_LEVEL = 0.02  # linear brightness below which colour says nothing about reflectance
BAND = (0.4, 0.35, 0.25)  # weights of linear red, green and blue in the guess of the infrared reflectance

_LINEAR = ((np.arange(256) / 255.0) ** 2.2).astype(np.float32)  # sRGB's curve, near enough for a guess


@lru_cache(maxsize=4)
def dot_pattern(dots: int, dot_width_px: float, seed: int) -> np.ndarray:
    """The projector's fixed pattern: randomly placed dots of unequal brightness, float32 `TABLE_SIDES_PX`, peak near 1.

    Args:
        dots: over the whole table.
        dot_width_px: standard deviation of a dot, pixels of the reference imager.
        seed: of the pattern.
    """
    rng = np.random.default_rng(seed)
    rows, columns = TABLE_SIDES_PX
    pattern = np.zeros(rows * columns, np.float32)
    np.add.at(pattern, rng.integers(0, rows * columns, dots), rng.uniform(0.5, 1.5, dots).astype(np.float32))
    sigma = max(dot_width_px * TABLE_PX / REFERENCE_FOCAL_PX, 0.4)
    spread = cv2.GaussianBlur(pattern.reshape(rows, columns), (0, 0), sigma)
    return spread * np.float32(2.0 * np.pi * sigma**2)


def white_noise(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """(height, width) float32 normal noise, read from a fixed table at a place that rng chooses."""
    row, column = rng.integers(0, TILE_SIDE_PX, 2)
    table = gaussian_tile((0.0,), (1.0,), TILE_SIDE_PX + width, 5)
    rows = (np.arange(height) + row) % TILE_SIDE_PX
    return table[rows, column : column + width]


def low_frequency_field(rng: np.random.Generator, height: int, width: int, deviation: float) -> np.ndarray:
    """(height, width) float32 field that varies over a third of the image, of a given standard deviation."""
    coarse = rng.normal(0.0, deviation, (5, 7)).astype(np.float32)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)


@dataclass(frozen=True, eq=False)
class Imager:
    """One infrared imager of one unit.

    Attributes:
        intrinsics: of its image.
        projector_x_m: of the projector in its frame, metres to the right.
        sensitivity: (H, W) float32, vignetting times fixed pattern.
        warp: (map_u, map_v) float32 sampling places that leave the rectification error behind, or None.
    """

    intrinsics: Intrinsics
    projector_x_m: float
    sensitivity: np.ndarray
    warp: tuple[np.ndarray, np.ndarray] | None

    @classmethod
    def draw(cls, config: StereoConfig, is_right: bool, rng: np.random.Generator) -> Imager:
        """A specimen; only the right one carries what rectification leaves, since matching sees the difference."""
        k = config.intrinsics
        height, width = k.height, k.width
        v, u = np.mgrid[:height, :width].astype(np.float32) + np.float32(0.5)
        radius2 = ((u - width / 2) ** 2 + (v - height / 2) ** 2) / (width**2 + height**2) * 4.0
        fixed = 1.0 + config.fixed_pattern * rng.standard_normal((height, width), dtype=np.float32)
        sensitivity = ((1.0 - config.vignetting * radius2) * fixed).astype(np.float32)
        x_m = config.baseline_m * PROJECTOR_X_SHARE
        if not is_right:
            return cls(k, x_m, sensitivity, None)
        across = low_frequency_field(rng, height, width, config.disparity_error_px)
        down = low_frequency_field(rng, height, width, config.rectification_error_px)
        return cls(k, x_m - config.baseline_m, sensitivity, (u - 0.5 + across, v - 0.5 + down))

    def expose(
        self, frame: Frame, pattern: np.ndarray, config: StereoConfig, ambient_gain: float, rng: np.random.Generator
    ) -> np.ndarray:
        """The image that this imager records.

        Args:
            frame: what an ideal camera sees from its place.
            pattern: `dot_pattern`.
            config: the camera.
            ambient_gain: infrared light per linear brightness of the frame.
            rng: of noise and speckle.

        Returns:
            uint8 (H, W).
        """
        light = self._light(frame, pattern, config, ambient_gain, rng)
        if self.warp is not None:
            light = cv2.remap(light, *self.warp, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        if config.lens_blur_px > 0.0:
            light = cv2.GaussianBlur(light, (0, 0), config.lens_blur_px)
        light *= self.sensitivity
        exposure = min(TARGET_LEVEL / max(float(light.mean()), 1e-6), config.exposure_limit)
        light *= np.float32(exposure)
        gain = min(max(TARGET_LEVEL / max(float(light.mean()), 1e-6), 1.0), config.gain_limit)
        noise = white_noise(rng, *light.shape)
        variance = np.float32(config.read_noise**2) + np.float32(config.shot_noise**2) * light
        light += noise * np.sqrt(variance, out=variance)
        return cv2.convertScaleAbs(np.maximum(light, np.float32(0.0)), alpha=gain * 255.0)

    def _light(
        self, frame: Frame, pattern: np.ndarray, config: StereoConfig, ambient_gain: float, rng: np.random.Generator
    ) -> np.ndarray:
        """Infrared light that reaches each pixel, (H, W) float32; 1 is a white sheet in a dot's middle at 1 m."""
        from stair_env.sensors.camera.renderers.threads import run_rows
        from stair_env.sensors.camera.stereo import kernels

        level = cv2.transform(cv2.LUT(frame.rgb, _LINEAR), np.array([BAND], np.float32))
        mean = max(float(level.mean()), 1e-6)
        if config.infrared_contrast != 1.0:
            level = np.float32(mean) * cv2.pow(level * np.float32(1.0 / mean), config.infrared_contrast)
        light = level * np.float32(ambient_gain)
        if config.projector_power == 0.0:
            return light
        k, shape = self.intrinsics, level.shape
        map_u, map_v, irradiance = (np.empty(shape, np.float32) for _ in range(3))
        rows, columns = TABLE_SIDES_PX
        depth_m = np.ascontiguousarray(frame.depth_m)

        def light_bands(bands: np.ndarray) -> None:
            kernels.light_from_projector(
                bands, depth_m, k.fx, k.cx, k.cy, self.projector_x_m,
                TABLE_PX, columns / 2.0, rows / 2.0, map_u, map_v, irradiance,
            )  # fmt: skip

        run_rows(light_bands, -(-shape[0] // kernels.BAND_PX))
        dots: np.ndarray = cv2.remap(
            pattern, map_u, map_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0
        )
        grain = white_noise(rng, *shape)
        grain *= np.float32(config.speckle)
        grain += np.float32(1.0)
        # A bright surface of a lit scene reflects much; in the dark, colour tells nothing and the middle is taken.
        trust = min(mean / DARK_SCENE_LEVEL, 1.0)
        reflectance: np.ndarray = np.minimum(level * np.float32(0.5 / mean), np.float32(1.0))
        reflectance *= np.float32(trust * (1.0 - LOWEST_REFLECTANCE))
        reflectance += np.float32(LOWEST_REFLECTANCE + (1.0 - LOWEST_REFLECTANCE) * (1.0 - trust) * 0.5)
        dots *= np.maximum(grain, np.float32(0.0), out=grain)
        dots *= irradiance
        dots *= reflectance
        dots *= np.float32(config.projector_power)
        light += dots
        return light
