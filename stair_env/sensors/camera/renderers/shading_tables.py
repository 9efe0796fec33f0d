"""An appearance as arrays, the form the shading kernel reads."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stair_env.scene.appearance import AppearanceSpec, SurfaceLook
from stair_env.scene.marks import LightPattern, Soiling
from stair_env.scene.shapes import Shape
from stair_env.sensors.camera.renderers import shading

MIP_CACHE = 128  # textures kept with their mip levels, 350 kB each
PLAIN_DENSITY = 1e6  # texels per metre of a surface without texture: a pixel covers the whole coarsest level


@dataclass(frozen=True)
class Looks:
    """The looks of a scene's surfaces; see `shading.shade_rows` for the arrays."""

    texels: np.ndarray
    base: np.ndarray
    values: np.ndarray


class LookTable:
    """Gives each look a number, and builds the arrays for those seen so far.

    Args:
        appearance: the scene's.
        textured: False paints each surface in its texture's mean colour.
    """

    def __init__(self, appearance: AppearanceSpec, textured: bool = True) -> None:
        self._appearance = appearance
        self._textured = textured
        self._numbers: dict[SurfaceLook, int] = {}
        self._by_surface: dict[str, tuple[int, int]] = {}
        self._arrays: Looks | None = None

    def numbers(self, shapes: Sequence[Shape]) -> np.ndarray:
        """(n, 2) int32: the look of each shape's faces that point up, and of the others.

        Raises:
            SpecError: a shape's surface has no look.
        """
        pairs = [self._by_surface.get(shape.surface) or self._pair(shape.surface) for shape in shapes]
        return np.array(pairs, dtype=np.int32).reshape(len(pairs), 2)

    def _pair(self, surface: str) -> tuple[int, int]:
        up = self._number(self._appearance.look(surface, faces_up=True))
        self._by_surface[surface] = (up, self._number(self._appearance.look(surface)))
        return self._by_surface[surface]

    def _number(self, look: SurfaceLook) -> int:
        if look not in self._numbers:
            self._numbers[look] = len(self._numbers)
            self._arrays = None
        return self._numbers[look]

    def arrays(self) -> Looks:
        """The arrays for every number given out so far."""
        if self._arrays is None:
            self._arrays = self._build()
        return self._arrays

    def _build(self) -> Looks:
        looks = list(self._numbers)
        textures = {(look.material, look.seed, look.wear): 0 for look in looks}
        for place, key in enumerate(textures):
            textures[key] = place
        values = np.zeros((len(looks), shading.NUM_LOOK), np.float32)
        for row, look in zip(values, looks):
            texture = look.texture
            density = shading.MIP_SIDE / (texture.metres_per_tile * look.texture_scale)
            row[shading.LOOK_DENSITY] = density if self._textured else PLAIN_DENSITY
            row[shading.LOOK_STRENGTH] = texture.specular
            row[shading.LOOK_SHININESS] = texture.shininess
            row[shading.LOOK_GAIN :] = np.array(look.gain) / 255.0**2  # the kernel squares texels of 0..255
        return Looks(
            texels=np.concatenate([mip_levels(*key) for key in textures]),
            base=np.array(
                [textures[look.material, look.seed, look.wear] * shading.MIP_TEXELS for look in looks], np.int32
            ),
            values=values,
        )


def linear_from_srgb(encoded: np.ndarray) -> np.ndarray:
    """Linear light 0..1 from sRGB 0..1, any shape."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


@functools.lru_cache(maxsize=MIP_CACHE)
def mip_levels(material: str, seed: int, wear: int = 0) -> np.ndarray:
    """(MIP_TEXELS,) int32 texels of all levels, finest first; see `shading.shade_rows` for their code."""
    albedo = SurfaceLook(material, seed, wear=wear).texture.albedo
    image = linear_from_srgb(np.arange(256) / 255.0).astype(np.float32)[albedo]
    if image.shape[0] != shading.MIP_SIDE:
        raise ValueError(f"the texture of {material!r} has {image.shape[0]} rows, must have {shading.MIP_SIDE}")
    levels = []
    for _ in range(shading.MIP_LEVELS):
        code = (np.sqrt(image) * 255.0 + 0.5).astype(np.int32)
        levels.append((code[..., 0] | code[..., 1] << 8 | code[..., 2] << 16).ravel())
        half = max(image.shape[0] // 2, 1)
        image = image.reshape(half, -1, half, image.shape[1] // half, 3).mean(axis=(1, 3))
    return np.concatenate(levels)


def light_settings(appearance: AppearanceSpec, shadows: bool) -> np.ndarray:
    """(NUM_SETTINGS,) float32 for the shading kernel."""
    lamp = appearance.lamp_position
    settings = np.zeros(shading.NUM_SETTINGS, np.float32)
    settings[shading.LIGHT : shading.LIGHT + 3] = appearance.light_direction if lamp is None else lamp
    settings[shading.LAMP] = lamp is not None
    settings[shading.COLOUR : shading.COLOUR + 3] = appearance.light_intensity * np.array(appearance.light_colour)
    settings[shading.AMBIENT : shading.AMBIENT + 3] = appearance.ambient_level * np.array(appearance.ambient_colour)
    settings[shading.EXPOSURE] = appearance.exposure
    settings[shading.GLOSS] = appearance.specular_strength
    settings[shading.HORIZON : shading.HORIZON + 3] = appearance.sky_horizon
    settings[shading.ZENITH : shading.ZENITH + 3] = appearance.sky_zenith
    casts = shadows and appearance.shadows and appearance.light_intensity > 0.0
    settings[shading.SHADOWS] = casts
    settings[shading.TILT : shading.TILT + 3] = appearance.ambient_tilt
    settings[shading.CORNER] = appearance.corner_shade
    if appearance.soiling is not None:
        _set_soiling(settings, appearance.soiling)
    if appearance.light_pattern is not None and casts:
        _set_pattern(settings, appearance.light_pattern)
    return settings


def _set_pattern(settings: np.ndarray, pattern: LightPattern) -> None:
    """Write the entries from PATTERN on."""
    first, second = pattern.period_m
    settings[shading.PATTERN : shading.PATTERN + shading.NUM_PATTERN] = (
        pattern.strength, math.cos(pattern.angle_rad), math.sin(pattern.angle_rad), 1.0 / first, 1.0 / second,
        *pattern.shade, *pattern.phase, 1.0 / pattern.softness, pattern.warp,
    )  # fmt: skip


def _set_soiling(settings: np.ndarray, soiling: Soiling) -> None:
    """Write GRIME and the entries from SOIL on."""
    settings[shading.GRIME] = soiling.grime
    along, across = soiling.patch_period_m
    settings[shading.SOIL : shading.SOIL + shading.NUM_SOIL] = (
        soiling.lane_gain, soiling.lane_y, 1.0 / soiling.lane_half_width, soiling.patch_strength, 1.0 / along,
        1.0 / across, *soiling.patch_phase, 1.0 - soiling.patch_share, soiling.wetness,
    )  # fmt: skip


def across(direction: np.ndarray) -> np.ndarray:
    """(2, 3) float32 unit vectors at right angles to a (3,) direction and to each other."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    return np.stack([first, second / np.linalg.norm(second)]).astype(np.float32)
