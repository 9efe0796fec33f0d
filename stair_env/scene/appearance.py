"""How a scene looks: what its surfaces are made of and how it is lit.

An `AppearanceSpec` is plain, JSON-able data. A renderer asks it for the look of a surface by the name that a
`stair_env.scene.shapes.Shape` carries, and shades with linear (not gamma-encoded) colours:

    radiance = albedo * (ambient * openness + light * max(0, n . l) * visible) + specular
    pixel    = sRGB(exposure * radiance)

Colours are linear RGB, 1.0 being a white sheet under a light of intensity 1 that strikes it squarely.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from stair_env.common.constants import SCENE_LIGHTINGS
from stair_env.common.field_kinds import naming_fields
from stair_env.common.validation import JsonSpec, SpecError, check_choice, check_range, from_fields
from stair_env.scene.marks import LightPattern, Soiling
from stair_env.scene.materials.textures import MATERIALS, Texture, make_texture
from stair_env.scene.materials.wear import WEAR_LEVELS
from stair_env.scene.shapes import Vector3

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
        material: one of `stair_env.scene.materials.textures.MATERIALS`.
        seed: which specimen of the material.
        tint: multiplies the texture's linear colour, each 0 to 2.
        brightness: multiplies all three channels, 0 to 2.
        texture_scale: size of the texture's features relative to life, 0.25 to 4.
        wear: how used it is, one of `stair_env.scene.materials.wear.WEAR_LEVELS`.

    Raises:
        SpecError: a field is out of range.
    """

    material: str = "concrete"
    seed: int = 0
    tint: Vector3 = WHITE
    brightness: float = 1.0
    texture_scale: float = 1.0
    wear: int = 0

    def __post_init__(self) -> None:
        check_choice("material", self.material, MATERIALS)
        check_range("seed", self.seed, 0, 2**31 - 1)
        object.__setattr__(self, "tint", check_vector("tint", self.tint, 0.0, 2.0))
        check_range("brightness", self.brightness, 0.0, 2.0)
        check_range("texture_scale", self.texture_scale, 0.25, 4.0)
        check_range("wear", self.wear, WEAR_LEVELS[0], WEAR_LEVELS[-1])

    @property
    def texture(self) -> Texture:
        """The (cached) texture of this specimen, without tint and brightness."""
        return make_texture(self.material, self.seed, self.wear)

    @property
    def gain(self) -> Vector3:
        """What the texture's linear colour is multiplied with: tint times brightness."""
        red, green, blue = self.tint
        return (red * self.brightness, green * self.brightness, blue * self.brightness)


@dataclass(frozen=True)
class NosingStrip:
    """A contrasting strip along the nosings.

    Args:
        width_m: how far it reaches back over the tread, metres.
        colour: linear RGB, 0 to 1.
        setback_m: bare tread between the nosing and the strip, metres; 0 puts it on the edge.
        drop_m: how far a strip without setback reaches down the riser, metres.
        material: what it is made of; the colour tints it.
        lines: 1, or 2 for two narrow stripes with as much bare tread between them.
        ends_only: only the first and the last nosing of a flight have one.
        inset_m: bare tread at either end, metres.
        wear: of the material, one of `stair_env.scene.materials.wear.WEAR_LEVELS`.
        missing: share of the strip's pieces that have come off, 0 to 1.
        seed: which pieces.

    Raises:
        SpecError: a field is out of range.
    """

    width_m: float = 0.04
    colour: Vector3 = (0.7, 0.5, 0.02)
    setback_m: float = 0.0
    drop_m: float = 0.012
    material: str = "painted"
    lines: int = 1
    ends_only: bool = False
    inset_m: float = 0.0
    wear: int = 0
    missing: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        check_range("width_m", self.width_m, 0.005, 0.12)
        object.__setattr__(self, "colour", check_vector("colour", self.colour, 0.0, 1.0))
        check_range("setback_m", self.setback_m, 0.0, 0.06)
        check_range("drop_m", self.drop_m, 0.001, 0.06)
        check_choice("material", self.material, MATERIALS)
        check_range("lines", self.lines, 1, 2)
        check_range("inset_m", self.inset_m, 0.0, 0.2)
        check_range("wear", self.wear, WEAR_LEVELS[0], WEAR_LEVELS[-1])
        check_range("missing", self.missing, 0.0, 1.0)
        check_range("seed", self.seed, 0, 2**31 - 1)

    @property
    def look(self) -> SurfaceLook:
        """The strip as a surface."""
        return SurfaceLook(self.material, tint=self.colour, wear=self.wear)


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
        ambient_tilt: where more of the ambient light comes from: a face whose normal points along this vector gets
            that much more of it (and less on the other side), world frame, each -0.4 to 0.4. By default from above.
        corner_shade: share of the ambient light that an inner edge keeps off, 0 to 1.
        light_pattern: what stands in the light's way out of sight, or None.
        soiling: where surfaces are trodden, damp or dirty, or None.

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
    ambient_tilt: Vector3 = (0.0, 0.0, 0.22)
    corner_shade: float = 0.5
    light_pattern: LightPattern | None = None
    soiling: Soiling | None = None

    @naming_fields
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
        object.__setattr__(self, "ambient_tilt", check_vector("ambient_tilt", self.ambient_tilt, -0.4, 0.4))
        check_range("corner_shade", self.corner_shade, 0.0, 1.0)

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
            parts = (("nosing_strip", NosingStrip), ("light_pattern", LightPattern), ("soiling", Soiling))
            for name, kind in parts:
                if values.get(name) is not None:
                    values[name] = from_fields(kind, values[name])
        built: Self = from_fields(cls, values)
        return built
