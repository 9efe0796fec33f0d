"""How a scene looks: what its surfaces are made of and how it is lit.

An `AppearanceSpec` is plain, JSON-able data. A renderer asks it for the look of a surface by the name that a
`stair_env.scene.shapes.Shape` carries, and shades with linear (not gamma-encoded) colours:

    radiance = albedo * (ambient + light * max(0, n . l) * visible) + specular
    pixel    = sRGB(exposure * radiance)

Colours are linear RGB, 1.0 being a white sheet under a light of intensity 1 that strikes it squarely.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from stair_env.common.constants import SCENE_LIGHTINGS
from stair_env.common.validation import JsonSpec, SpecError, check_choice, check_range, from_fields
from stair_env.scene.shapes import Vector3
from stair_env.scene.textures import MATERIALS, Texture, make_texture

if TYPE_CHECKING:
    from typing_extensions import Self

Lighting = Literal["day", "night"]

SURFACES: tuple[str, ...] = ("step", "floor", "wall", "ceiling", "rail", "stringer", "nosing", "robot")
DISTRACTOR_PREFIX = "distractor:"  # "distractor:KIND" or "distractor:KIND:INDEX", INDEX into the palette
WHITE: Vector3 = (1.0, 1.0, 1.0)


def check_vector(name: str, value: Sequence[float], low: float, high: float) -> Vector3:
    """Return value as a tuple of three floats.

    Raises:
        SpecError: it is not three numbers in [low, high].
    """
    try:
        x, y, z = (float(part) for part in value)
    except (TypeError, ValueError):
        raise SpecError(f"{name}={value!r} must be three numbers in [{low:g}, {high:g}]") from None
    for part in (x, y, z):
        check_range(name, part, low, high)
    return (x, y, z)


@dataclass(frozen=True)
class SurfaceLook:
    """What one surface is made of.

    Args:
        material: one of `stair_env.scene.textures.MATERIALS`.
        seed: which specimen of the material.
        tint: multiplies the texture's linear colour, each 0 to 2.
        brightness: multiplies all three channels, 0 to 2.
        texture_scale: size of the texture's features relative to life, 0.25 to 4.

    Raises:
        SpecError: a field is out of range.
    """

    material: str = "concrete"
    seed: int = 0
    tint: Vector3 = WHITE
    brightness: float = 1.0
    texture_scale: float = 1.0

    def __post_init__(self) -> None:
        check_choice("material", self.material, MATERIALS)
        check_range("seed", self.seed, 0, 2**31 - 1)
        object.__setattr__(self, "tint", check_vector("tint", self.tint, 0.0, 2.0))
        check_range("brightness", self.brightness, 0.0, 2.0)
        check_range("texture_scale", self.texture_scale, 0.25, 4.0)

    @property
    def texture(self) -> Texture:
        """The (cached) texture of this specimen, without tint and brightness."""
        return make_texture(self.material, self.seed)

    @property
    def gain(self) -> Vector3:
        """What the texture's linear colour is multiplied with: tint times brightness."""
        red, green, blue = self.tint
        return (red * self.brightness, green * self.brightness, blue * self.brightness)


@dataclass(frozen=True)
class NosingStrip:
    """A contrasting strip along every nosing.

    Args:
        width_m: how far it reaches back over the tread, metres.
        colour: linear RGB, 0 to 1.
        setback_m: bare tread between the nosing and the strip, metres; 0 puts it on the edge.

    Raises:
        SpecError: a field is out of range.
    """

    width_m: float = 0.04
    colour: Vector3 = (0.7, 0.5, 0.02)
    setback_m: float = 0.0

    def __post_init__(self) -> None:
        check_range("width_m", self.width_m, 0.005, 0.12)
        object.__setattr__(self, "colour", check_vector("colour", self.colour, 0.0, 1.0))
        check_range("setback_m", self.setback_m, 0.0, 0.06)

    @property
    def look(self) -> SurfaceLook:
        """The strip as a painted surface."""
        return SurfaceLook("painted", tint=self.colour)


@dataclass(frozen=True)
class AppearanceSpec(JsonSpec):
    """Materials and light of a scene, JSON-able and validated.

    Args:
        lighting: "day" or "night".
        tread, riser: upward and other faces of the steps.
        floor, wall, ceiling, rail, stringer, robot: the other surfaces.
        distractors: palette for distractors, at least one.
        nosing_strip: strip along the nosings, or None.
        light_direction: unit vector from the scene towards the light (normalised here), world frame. Used when
            lamp_position is None.
        lamp_position: a lamp at this world position, metres; its intensity holds at 1 m and falls with the square.
        light_colour: linear RGB, 0 to 1.
        light_intensity: 0 to 50.
        ambient_level: light that comes from everywhere, 0 to 2.
        ambient_colour: its linear RGB, 0 to 1.
        shadows: whether the light casts shadows.
        exposure: multiplies the radiance before encoding, 0 to 16.
        specular_strength: multiplies each material's own gloss, 0 to 4.
        sky_horizon, sky_zenith: linear RGB of what no surface hides.

    Raises:
        SpecError: a field is out of range.
    """

    lighting: Lighting = "day"
    tread: SurfaceLook = SurfaceLook("concrete")
    riser: SurfaceLook = SurfaceLook("concrete")
    floor: SurfaceLook = SurfaceLook("tile")
    wall: SurfaceLook = SurfaceLook("painted")
    ceiling: SurfaceLook = SurfaceLook("painted")
    rail: SurfaceLook = SurfaceLook("metal")
    stringer: SurfaceLook = SurfaceLook("wood")
    robot: SurfaceLook = SurfaceLook("metal", brightness=0.35)
    distractors: tuple[SurfaceLook, ...] = (SurfaceLook("wood"),)
    nosing_strip: NosingStrip | None = None
    light_direction: Vector3 = (-0.35, 0.3, 0.89)
    lamp_position: Vector3 | None = None
    light_colour: Vector3 = (1.0, 0.96, 0.9)
    light_intensity: float = 1.0
    ambient_level: float = 0.45
    ambient_colour: Vector3 = (0.9, 0.95, 1.0)
    shadows: bool = True
    exposure: float = 1.0
    specular_strength: float = 1.0
    sky_horizon: Vector3 = (0.75, 0.82, 0.9)
    sky_zenith: Vector3 = (0.25, 0.45, 0.8)

    def __post_init__(self) -> None:
        check_choice("lighting", self.lighting, SCENE_LIGHTINGS)
        if not self.distractors:
            raise SpecError("distractors=() must hold at least one look")
        object.__setattr__(self, "distractors", tuple(self.distractors))
        for name in ("light_colour", "ambient_colour", "sky_horizon", "sky_zenith"):
            object.__setattr__(self, name, check_vector(name, getattr(self, name), 0.0, 1.0))
        direction = check_vector("light_direction", self.light_direction, -1e3, 1e3)
        length = math.sqrt(sum(part * part for part in direction))
        if length < 1e-6:
            raise SpecError(f"light_direction={direction!r} must not be zero")
        if abs(length - 1.0) > 1e-9:  # leave a unit vector as it is, so that a JSON round trip is exact
            direction = (direction[0] / length, direction[1] / length, direction[2] / length)
        object.__setattr__(self, "light_direction", direction)
        if self.lamp_position is not None:
            object.__setattr__(self, "lamp_position", check_vector("lamp_position", self.lamp_position, -100, 100))
        check_range("light_intensity", self.light_intensity, 0.0, 50.0)
        check_range("ambient_level", self.ambient_level, 0.0, 2.0)
        check_range("exposure", self.exposure, 0.0, 16.0)
        check_range("specular_strength", self.specular_strength, 0.0, 4.0)

    def look(self, surface: str, faces_up: bool = False) -> SurfaceLook:
        """The look of a shape's face.

        Args:
            surface: `Shape.surface`.
            faces_up: whether the face's normal points up; only steps tell the two apart.

        Raises:
            SpecError: no such surface.
        """
        if surface.startswith(DISTRACTOR_PREFIX):
            _, _, index = surface[len(DISTRACTOR_PREFIX) :].partition(":")
            return self.distractors[int(index or 0) % len(self.distractors)]
        check_choice("surface", surface, (*SURFACES, DISTRACTOR_PREFIX + "KIND"))
        if surface == "step":
            return self.tread if faces_up else self.riser
        if surface == "nosing":
            return (self.nosing_strip or NosingStrip()).look
        found: SurfaceLook = getattr(self, surface)
        return found

    @classmethod
    def from_dict(cls, values: Any) -> Self:
        """Rebuild a spec from `dataclasses.asdict` output.

        Raises:
            SpecError: values is no dict or holds an unknown field.
        """
        values = dict(values) if isinstance(values, dict) else values
        if isinstance(values, dict):
            for name in ("tread", "riser", "floor", "wall", "ceiling", "rail", "stringer", "robot"):
                if name in values:
                    values[name] = from_fields(SurfaceLook, values[name])
            if "distractors" in values:
                values["distractors"] = tuple(from_fields(SurfaceLook, look) for look in values["distractors"])
            if values.get("nosing_strip") is not None:
                values["nosing_strip"] = from_fields(NosingStrip, values["nosing_strip"])
        built: Self = from_fields(cls, values)
        return built
