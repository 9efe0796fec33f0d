"""Random materials and light."""

from __future__ import annotations

import colorsys
import dataclasses
import math
from typing import Any

import numpy as np

from stair_env.scene.appearance import Lighting, NosingStrip, SurfaceLook
from stair_env.scene.objects.palette import PALETTE
from stair_env.scene.shapes import Vector3
from stair_env.scene.surroundings import Enclosure, SurroundingsSpec
from stair_env.stairs import StairSpec

SPECIMENS = 16  # of each material: few enough for the texture cache to help, tints make the rest of the variety
SAME_MATERIAL_SHARE = 0.55  # riser like tread: only shading shows the edge
OTHER_TONE_SHARE = 0.35  # of the rest: the same stuff, painted or worn to another tone
STRIP_SHARE = 0.35
WEAR_SHARES = (0.4, 0.3, 0.2, 0.1)  # of `stair_env.scene.materials.wear.WEAR_LEVELS`
OVERCAST_SHARE = 0.35  # of the days outdoors
GLARE_SHARE = 0.1
TINT_SHARE = 0.12  # of the lights are coloured: neon, old sodium lamps, awnings

INDOOR_TREADS = (
    "wood", "wood", "concrete", "concrete", "terrazzo", "tile", "carpet", "carpet", "painted", "metal", "rubber",
    "granite", "marble", "slab_tile", "linoleum", "parquet", "grating",
)  # fmt: skip
OUTDOOR_TREADS = (
    "concrete", "concrete", "concrete", "tile", "brick", "wood", "metal", "terrazzo", "granite", "stone", "stone",
    "paving", "slab_tile", "grating", "decking", "painted",
)  # fmt: skip
RISERS = (
    "concrete", "wood", "tile", "painted", "painted", "brick", "terrazzo", "metal", "granite", "stone", "marble",
    "slab_tile", "rubber", "panelling",
)  # fmt: skip
INDOOR_FLOORS = (
    "wood", "tile", "terrazzo", "concrete", "carpet", "parquet", "marble", "linoleum", "slab_tile", "rubber", "granite",
)  # fmt: skip
OUTDOOR_FLOORS = (
    "concrete", "concrete", "tile", "brick", "asphalt", "asphalt", "paving", "paving", "grass", "stone", "granite",
    "slab_tile", "decking",
)  # fmt: skip
INDOOR_WALLS = (
    "painted", "painted", "painted", "painted", "brick", "concrete", "wood", "panelling", "slab_tile", "siding",
)  # fmt: skip
OUTDOOR_WALLS = ("brick", "brick", "concrete", "painted", "siding", "stone", "panelling")
TINTED = ("painted", "siding", "panelling")  # near white, so that a paint decides the colour
MEAN_ALBEDO = {  # linear, over the first 16 specimens
    "concrete": 0.28,
    "terrazzo": 0.30,
    "wood": 0.19,
    "tile": 0.35,
    "brick": 0.20,
    "metal": 0.25,
    "carpet": 0.12,
    "painted": 0.82,
    "rubber": 0.06,
    "granite": 0.19,
    "marble": 0.31,
    "grating": 0.13,
    "paving": 0.20,
    "stone": 0.20,
    "slab_tile": 0.27,
    "parquet": 0.19,
    "asphalt": 0.09,
    "grass": 0.07,
    "linoleum": 0.19,
    "decking": 0.13,
    "siding": 0.52,
    "panelling": 0.68,
}
MIDDLE_ALBEDO = 0.28
EXPOSURE_FOLLOWING = 0.6  # exponent: 1 would make every picture equally bright
STRIP_COLOURS: tuple[Vector3, ...] = (
    (0.75, 0.48, 0.02),  # yellow
    (0.02, 0.02, 0.02),  # black rubber
    (0.8, 0.8, 0.78),  # white
    (0.35, 0.36, 0.38),  # aluminium
    (0.3, 0.12, 0.04),  # brown
    (0.02, 0.15, 0.08),  # luminous green
)


def _choice(rng: np.random.Generator, options: tuple[Any, ...]) -> Any:
    return options[int(rng.integers(len(options)))]


def _paint(rng: np.random.Generator, strong: float) -> Vector3:
    """Linear colour of a paint; `strong` is how often it is a vivid one."""
    if rng.random() < strong:
        red, green, blue = colorsys.hsv_to_rgb(
            float(rng.random()), float(rng.uniform(0.25, 0.6)), float(rng.uniform(0.3, 0.75))
        )
    else:
        warm = float(rng.normal(0.0, 0.05))
        level = float(rng.uniform(0.5, 0.95))
        red, green, blue = level * (1 + warm), level * (1 + 0.3 * warm), level * (1 - warm)
    return (min(red, 1.0) ** 1.4, min(green, 1.0) ** 1.4, min(blue, 1.0) ** 1.4)


def draw_look(
    rng: np.random.Generator, materials: tuple[str, ...], strong_paint: float = 0.2, patterned: float = 0.5
) -> SurfaceLook:
    """A specimen of one of the materials, a little lighter or darker than the next.

    Args:
        rng: the source of all chance.
        materials: to choose from; one named twice is chosen twice as often.
        strong_paint: how often a paint is a vivid one.
        patterned: how often boards stand for a slab of wood, chequer plate for sheet metal and so on.
    """
    material = _choice(rng, materials)
    if material in TINTED:
        tint = _paint(rng, strong_paint)
    else:
        warm = float(rng.normal(0.0, 0.035))
        tint = (1.0 + warm, 1.0, 1.0 - warm)
    return SurfaceLook(
        material,
        seed=2 * int(rng.integers(SPECIMENS // 2)) + int(rng.random() < patterned),
        tint=tint,
        brightness=float(rng.uniform(0.75, 1.15)),
        texture_scale=float(rng.uniform(0.8, 1.25)),
        wear=int(rng.choice(len(WEAR_SHARES), p=WEAR_SHARES)),
    )


def draw_strip(rng: np.random.Generator) -> NosingStrip:
    """A strip along the nosings: painted, of rubber or of metal, on the edge or set back, whole or coming off."""
    set_back = rng.random() < 0.35
    material = _choice(rng, ("painted", "painted", "painted", "rubber", "metal"))
    neutral = float(rng.uniform(0.6, 1.0))
    return NosingStrip(
        width_m=float(rng.uniform(0.02, 0.07)),
        colour=_choice(rng, STRIP_COLOURS) if material == "painted" else (neutral, neutral, neutral),
        setback_m=float(rng.uniform(0.008, 0.03)) if set_back else 0.0,
        drop_m=float(rng.uniform(0.025, 0.05)) if rng.random() < 0.35 else float(rng.uniform(0.004, 0.015)),
        material=material,
        lines=2 if rng.random() < 0.15 else 1,
        ends_only=bool(rng.random() < 0.12),
        inset_m=float(rng.uniform(0.02, 0.12)) if rng.random() < 0.3 else 0.0,
        wear=int(rng.choice(len(WEAR_SHARES), p=WEAR_SHARES)),
        missing=float(rng.uniform(0.1, 0.5)) if rng.random() < 0.12 else 0.0,
        seed=int(rng.integers(2**30)),
    )


def draw_materials(rng: np.random.Generator, indoors: bool, strips: bool = True) -> dict[str, Any]:
    """The surface fields of an AppearanceSpec."""
    tread = draw_look(rng, INDOOR_TREADS if indoors else OUTDOOR_TREADS, patterned=0.3)
    if rng.random() < SAME_MATERIAL_SHARE:
        riser = tread
    elif rng.random() < OTHER_TONE_SHARE:
        riser = dataclasses.replace(
            tread, brightness=float(np.clip(tread.brightness * rng.uniform(0.7, 1.3), 0.4, 1.3))
        )
    else:
        riser = draw_look(rng, RISERS, patterned=0.2)
    floor = draw_look(rng, INDOOR_FLOORS if indoors else OUTDOOR_FLOORS, patterned=0.85)
    if rng.random() < 0.3 and tread.material in INDOOR_FLOORS + OUTDOOR_FLOORS:
        floor = dataclasses.replace(tread, seed=tread.seed | 1) if tread.material == "wood" else tread  # boards
    strip = draw_strip(rng) if strips and rng.random() < STRIP_SHARE else None
    wall = draw_look(rng, INDOOR_WALLS if indoors else OUTDOOR_WALLS, strong_paint=0.15)
    return {
        "tread": tread,
        "riser": riser,
        "floor": floor,
        "wall": wall,
        "ceiling": SurfaceLook("painted", seed=int(rng.integers(SPECIMENS)), tint=(0.9, 0.9, 0.88)),
        "rail": draw_look(rng, ("metal", "metal", "wood", "painted"), strong_paint=0.5, patterned=0.0),
        "stringer": tread
        if rng.random() < 0.4
        else draw_look(rng, ("wood", "metal", "painted", "concrete"), patterned=0.0),
        "distractors": tuple(draw_look(rng, (material,), strong_paint=0.6, patterned=0.2) for material in PALETTE),
        "nosing_strip": strip,
    }


def _direction(azimuth: float, elevation: float) -> Vector3:
    return (
        math.cos(elevation) * math.cos(azimuth),
        math.cos(elevation) * math.sin(azimuth),
        math.sin(elevation),
    )


def _lamp_position(rng: np.random.Generator, room: Enclosure, stairs: StairSpec | None) -> Vector3:
    """Under the ceiling, somewhere above the flight or what lies before and behind it."""
    last = 1.5 if stairs is None else float(stairs.profile().edge_x[-1])
    x = float(rng.uniform(-1.5, min(last + 1.5, room.x_high - 0.3)))
    y = float(rng.uniform(0.6 * room.y_right, 0.6 * room.y_left))
    return (x, y, room.z_top - float(rng.uniform(0.08, 0.4)))


def automatic_exposure(materials: dict[str, Any]) -> float:
    """Factor by which a camera opens up for dark surfaces and closes for light ones, about 1 for middle ones.

    Args:
        materials: as from `draw_materials`.
    """
    looks: list[SurfaceLook] = [materials[name] for name in ("tread", "riser", "floor", "wall")]
    mean = sum(MEAN_ALBEDO[look.material] * sum(look.gain) / 3 for look in looks) / len(looks)
    return float((MIDDLE_ALBEDO / max(mean, 0.02)) ** EXPOSURE_FOLLOWING)


def draw_light(
    rng: np.random.Generator,
    lighting: Lighting,
    surroundings: SurroundingsSpec,
    room: Enclosure,
    stairs: StairSpec | None,
    exposure: float = 1.0,
) -> dict[str, Any]:
    """The light fields of an AppearanceSpec.

    Args:
        rng: the source of all chance.
        lighting: "day" or "night".
        surroundings: decides where light can come from.
        room: its walls, metres.
        stairs: what lamps hang above.
        exposure: by day, multiplies the drawn exposure; see `automatic_exposure`.
    """
    if lighting == "night":
        return _night(rng, surroundings, room, stairs)
    fields = _indoors(rng, surroundings, room, stairs) if surroundings.kind == "indoor" else _outdoors(rng)
    fields["exposure"] *= exposure
    return fields


def _colour_of_light(rng: np.random.Generator, warm_low: float, warm_high: float) -> Vector3:
    """From bluish (below 0) over neutral to the orange of a filament (1)."""
    warm = float(rng.uniform(warm_low, warm_high))
    if rng.random() < TINT_SHARE:
        red, green, blue = colorsys.hsv_to_rgb(float(rng.random()), float(rng.uniform(0.1, 0.4)), 1.0)
        return (red, green, blue)
    return (1.0 if warm >= 0 else 1.0 + 0.3 * warm, 1.0 - 0.22 * abs(warm), 1.0 - 0.55 * max(warm, 0.0))


def _outdoors(rng: np.random.Generator) -> dict[str, Any]:
    overcast = rng.random() < OVERCAST_SHARE
    elevation = math.radians(float(rng.uniform(8.0, 75.0)))
    sun = float(rng.uniform(0.0, 0.25)) if overcast else float(rng.uniform(0.8, 1.5))
    ambient = float(rng.uniform(0.65, 0.9)) if overcast else float(rng.uniform(0.25, 0.5))
    grey = float(rng.uniform(0.6, 0.85))
    glare = rng.random() < GLARE_SHARE
    return {
        "lighting": "day",
        "light_direction": _direction(float(rng.uniform(-math.pi, math.pi)), elevation),
        "light_colour": _colour_of_light(rng, 0.0, 0.35 if elevation > 0.6 else 0.7),
        "light_intensity": sun,
        "ambient_level": ambient,
        "ambient_colour": (0.95, 0.97, 1.0) if overcast else (0.8, 0.9, 1.0),
        "shadows": not overcast,
        "exposure": float(rng.uniform(0.75, 1.2)) / (ambient + 0.6 * sun) * (1.35 if glare else 1.0),
        "specular_strength": float(rng.uniform(1.8, 3.0)) if glare else float(rng.uniform(0.4, 1.2)),
        "sky_horizon": (grey, grey, grey) if overcast else (0.72, 0.82, 0.92),
        "sky_zenith": (0.8 * grey, 0.82 * grey, 0.85 * grey) if overcast else (0.2, 0.4, 0.78),
    }


def _indoors(
    rng: np.random.Generator, surroundings: SurroundingsSpec, room: Enclosure, stairs: StairSpec | None
) -> dict[str, Any]:
    ambient = float(rng.uniform(0.25, 0.5))
    glare = rng.random() < GLARE_SHARE
    fields: dict[str, Any] = {
        "lighting": "day",
        "ambient_level": ambient,
        "ambient_colour": _colour_of_light(rng, -0.2, 0.3),
        "shadows": bool(rng.random() < 0.9),
        "specular_strength": float(rng.uniform(1.8, 3.0)) if glare else float(rng.uniform(0.4, 1.2)),
    }
    if surroundings.window != "none":
        side = 1.0 if surroundings.window == "left" else -1.0
        azimuth = side * math.pi / 2 + float(rng.normal(0.0, 0.4))
        fields["light_direction"] = _direction(azimuth, math.radians(float(rng.uniform(25.0, 55.0))))
        fields["light_colour"] = _colour_of_light(rng, 0.0, 0.5)
        sun = ambient * float(rng.uniform(2.0, 4.5))
        fields["light_intensity"] = sun
        fields["exposure"] = float(rng.uniform(0.8, 1.2)) / (ambient + 0.25 * sun) * (1.3 if glare else 1.0)
        return fields
    lamp = _lamp_position(rng, room, stairs)
    drop = lamp[2] - room.z_back / 2  # to about the middle of the flight
    at_floor = float(rng.uniform(0.4, 0.9))
    fields["lamp_position"] = lamp
    fields["light_colour"] = _colour_of_light(rng, -0.1, 0.7)
    fields["light_intensity"] = min(at_floor * drop * drop, 50.0)
    fields["exposure"] = float(rng.uniform(0.8, 1.25)) / (ambient + 0.6 * at_floor) * (1.25 if glare else 1.0)
    return fields


def _night(
    rng: np.random.Generator, surroundings: SurroundingsSpec, room: Enclosure, stairs: StairSpec | None
) -> dict[str, Any]:
    """A lamp far off, the moon, or next to nothing; `brightness` is what a white sheet would reach in the picture."""
    fields: dict[str, Any] = {
        "lighting": "night",
        "ambient_colour": (0.75, 0.85, 1.0),
        "specular_strength": float(rng.uniform(0.4, 1.5)),
        "sky_horizon": (0.006, 0.007, 0.012),
        "sky_zenith": (0.001, 0.001, 0.003),
        "exposure": 1.0,
    }
    kind = rng.random()
    if kind < 0.6:  # one lamp, weak or far
        lamp = _lamp_position(rng, room, stairs)
        if surroundings.kind != "indoor":
            lamp = (lamp[0] + float(rng.normal(0.0, 2.0)), lamp[1] + float(rng.normal(0.0, 2.0)), room.z_top + 0.5)
        drop = lamp[2] - room.z_back / 2
        fields["lamp_position"] = lamp
        fields["light_intensity"] = min(10 ** float(rng.uniform(-1.4, -0.25)) * drop * drop, 50.0)
        fields["light_colour"] = _colour_of_light(rng, 0.1, 1.0)
        fields["ambient_level"] = 10 ** float(rng.uniform(-2.2, -1.3))
    elif kind < 0.87:  # moon or street light through the clouds
        fields["light_direction"] = _direction(
            float(rng.uniform(-math.pi, math.pi)), math.radians(float(rng.uniform(25, 70)))
        )
        fields["light_intensity"] = 10 ** float(rng.uniform(-1.8, -0.9))
        fields["light_colour"] = _colour_of_light(rng, -0.6, 0.0)
        fields["ambient_level"] = 10 ** float(rng.uniform(-1.9, -1.2))
    else:  # next to nothing
        fields["light_intensity"] = 0.0
        fields["shadows"] = False
        fields["ambient_level"] = 10 ** float(rng.uniform(-3.0, -1.7))
    return fields
