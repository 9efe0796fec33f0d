"""Things that look like stairs and are not, and things that stand about and hide parts of them.

A distractor is laid out in its own frame (x forward, y left, z up, origin on the floor below its middle), then turned
about the vertical and put in its place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stair_env.common.validation import SpecError, check_choice, check_range
from stair_env.scene.objects.clutter import CLUTTER
from stair_env.scene.objects.look_alikes import LOOK_ALIKES
from stair_env.scene.objects.solid_parts import PAINT_THICKNESS_M, Builder, Extent, Part, box
from stair_env.scene.shapes import IDENTITY, Quaternion, Shape, Vector3

MAX_PARTS = 20  # bars, slats, stripes: a renderer pays for each


@dataclass(frozen=True)
class DistractorSpec:
    """One distractor, JSON-able and validated.

    Args:
        kind: one of DISTRACTOR_KINDS.
        position: of the middle of its foot, world frame, metres.
        yaw_rad: turn about the vertical.
        size: extent along its own x, y and z, metres. For what is painted, z is not used.
        count: number of stripes, bars, slats, shelves, planks or boxes.
        seed: of its small irregularities.
        look: index into the appearance's palette of distractors.

    Raises:
        SpecError: a field is out of range.
    """

    kind: str
    position: Vector3 = (0.0, 0.0, 0.0)
    yaw_rad: float = 0.0
    size: Vector3 = (1.0, 1.0, 1.0)
    count: int = 6
    seed: int = 0
    look: int = 0

    def __post_init__(self) -> None:
        check_choice("kind", self.kind, DISTRACTOR_KINDS)
        for name, low, high in (("position", -100.0, 100.0), ("size", 0.01, 20.0)):
            values = tuple(float(value) for value in getattr(self, name))
            if len(values) != 3:
                raise SpecError(f"{name}={values!r} must be three numbers")
            for value in values:
                check_range(name, value, low, high)
            object.__setattr__(self, name, values)
        check_range("yaw_rad", self.yaw_rad, -2 * math.pi, 2 * math.pi)
        for name, low, high in (("count", 1, MAX_PARTS), ("seed", 0, 2**31 - 1), ("look", 0, 255)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
                raise SpecError(f"{name}={value!r} must be a whole number")
            check_range(name, value, low, high)
            object.__setattr__(self, name, int(value))

    @property
    def surface(self) -> str:
        """Name under which an appearance finds the look."""
        return f"distractor:{self.kind}:{self.look}"

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Its solids in the world frame."""
        builder, collides = _BUILDERS[self.kind]
        parts = builder(self, np.random.default_rng(self.seed))
        return tuple(_place(self, part, collides) for part in parts)


def _place(spec: DistractorSpec, part: Part, collides: bool) -> Shape:
    """Turn and move a part into the world frame."""
    cos, sin = math.cos(spec.yaw_rad), math.sin(spec.yaw_rad)
    x, y, z = part.centre
    position = (
        spec.position[0] + cos * x - sin * y,
        spec.position[1] + sin * x + cos * y,
        spec.position[2] + z,
    )
    look = spec.look + part.look_shift if part.look is None else part.look
    surface = f"distractor:{spec.kind}:{look}"
    return Shape(part.kind, position, part.size, _yaw_pitch(spec.yaw_rad + part.yaw, part.pitch), surface, collides)


def _yaw_pitch(yaw: float, pitch: float) -> Quaternion:
    """Rotation about y by pitch, then about z by yaw."""
    if yaw == 0.0 and pitch == 0.0:
        return IDENTITY
    cy, sy, cp, sp = math.cos(yaw / 2), math.sin(yaw / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    return (-sy * sp, cy * sp, sy * cp, cy * cp)


def _stripes(spec: Extent, share: float) -> list[Part]:
    """Painted bars across y, repeating along x; `share` of the period is paint."""
    length, width, _ = spec.size
    period = length / spec.count
    return [
        box(
            (-length / 2 + k * period, -width / 2, 0.0),
            (-length / 2 + (k + share) * period, width / 2, PAINT_THICKNESS_M),
        )
        for k in range(spec.count)
    ]


def _crosswalk(spec: Extent, rng: np.random.Generator) -> list[Part]:
    return _stripes(spec, float(rng.uniform(0.4, 0.6)))


def _floor_stripes(spec: Extent, rng: np.random.Generator) -> list[Part]:
    return _stripes(spec, min(0.5, float(rng.uniform(0.03, 0.1)) * spec.count / spec.size[0]))


def _tile_seams(spec: Extent, rng: np.random.Generator) -> list[Part]:
    return _stripes(spec, min(0.5, float(rng.uniform(0.006, 0.02)) * spec.count / spec.size[0]))


def _mat(spec: Extent, rng: np.random.Generator) -> list[Part]:
    length, width, _ = spec.size
    thickness = float(rng.uniform(0.005, 0.015))
    border = 0.06
    inner = (length / 2 - border, width / 2 - border)
    parts = [box((-length / 2, -width / 2, 0.0), (length / 2, width / 2, thickness))]
    if min(inner) > 0.05:
        parts.append(box((-inner[0], -inner[1], 0.0), (inner[0], inner[1], thickness + 0.002), look_shift=1))
    return parts


def _planks(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Boards lying about, side by side along x with gaps, none quite straight."""
    length, width, _ = spec.size
    period = length / spec.count
    parts = []
    for k in range(spec.count):
        half = (
            period * float(rng.uniform(0.25, 0.42)),
            width / 2 * float(rng.uniform(0.75, 1.0)),
            float(rng.uniform(0.008, 0.022)),
        )
        centre = (-length / 2 + (k + 0.5) * period, float(rng.normal(0.0, 0.03)), half[2])
        parts.append(Part(centre, half, yaw=float(rng.normal(0.0, 0.03))))
    return parts


def _shelf(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Boards between two cheeks, open towards -x, with a few boxes on them."""
    depth, width, height = spec.size
    board = 0.012
    parts = [
        box((-depth / 2, side * width / 2 - board, 0.0), (depth / 2, side * width / 2 + board, height))
        for side in (-1, 1)
    ]
    levels = np.linspace(0.06, height - board, max(2, min(spec.count, 9)))
    for z in levels:
        parts.append(box((-depth / 2, -width / 2, float(z) - board), (depth / 2, width / 2, float(z) + board)))
    clearance = float(levels[1] - levels[0]) - 3 * board
    for z in levels[:-1]:
        if rng.random() < 0.6 and clearance > 0.08:
            y = float(rng.uniform(-0.3, 0.3)) * width
            half = float(rng.uniform(0.06, 0.18)) * width
            top = float(z) + board + clearance * float(rng.uniform(0.4, 0.95))
            parts.append(box((-depth * 0.4, y - half, float(z) + board), (depth * 0.35, y + half, top), look_shift=1))
    return parts


def _ramp(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """An inclined slab that rises along +x to the height of its size, and the block it ends on."""
    length, width, height = spec.size
    thickness, rise = 0.04, min(height, 0.8 * length)
    pitch = math.atan2(rise, length)
    half_length = math.hypot(length, rise) / 2
    middle = (-0.5 * thickness * -math.sin(pitch), 0.0, rise / 2 - 0.5 * thickness * math.cos(pitch))
    block = box((length / 2, -width / 2, 0.0), (length / 2 + float(rng.uniform(0.3, 1.0)), width / 2, rise))
    return [Part(middle, (half_length, width / 2, thickness / 2), pitch=-pitch), block]


def _fence(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Bars between two posts: a ladder of horizontal ones, or pickets."""
    _, width, height = spec.size
    radius = float(rng.uniform(0.01, 0.025))
    posts = [Part((0.0, side * width / 2, height / 2), (radius * 1.6, radius * 1.6, height / 2)) for side in (-1, 1)]
    if rng.random() < 0.65:
        levels = np.linspace(0.12, height - radius, spec.count)
        return posts + [Part((0.0, 0.0, float(z)), (radius, width / 2, radius)) for z in levels]
    places = np.linspace(-width / 2, width / 2, spec.count + 2)[1:-1]
    bars = [Part((0.0, float(y), height / 2), (radius, radius, height / 2 - 0.05)) for y in places]
    rails = [Part((0.0, 0.0, float(z)), (radius, width / 2, radius)) for z in (0.1, height - 0.06)]
    return posts + rails + bars


def _blinds(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Horizontal slats in front of a panel that faces -x."""
    _, width, height = spec.size
    tilt = float(rng.uniform(-0.9, 0.9))
    pitch = height / spec.count
    panel = box((0.03, -width / 2 - 0.05, 0.0), (0.05, width / 2 + 0.05, height), look_shift=1)
    slats = [
        Part((0.0, 0.0, (k + 0.5) * pitch), (min(0.42 * pitch, 0.05), width / 2, 0.002), pitch=tilt + math.pi / 2 * 0.6)
        for k in range(spec.count)
    ]
    return [panel, *slats]


def _bench(spec: Extent, rng: np.random.Generator) -> list[Part]:
    depth, width, height = spec.size
    seat = 0.03
    parts = [
        box(
            (-depth / 2, -width / 2 + place * (width - 0.1), 0.0),
            (depth / 2, -width / 2 + place * (width - 0.1) + 0.1, height - seat),
        )
        for place in (0.0, 1.0)
    ]
    slats = 1 + 2 * int(rng.integers(0, 2))
    pitch = depth / slats
    for k in range(slats):
        gap = 0.01 if slats > 1 else 0.0
        low = -depth / 2 + k * pitch + gap
        parts.append(box((low, -width / 2, height - seat), (low + pitch - 2 * gap, width / 2, height), look_shift=1))
    return parts


def _boxes(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Crates stacked and set side by side."""
    length, width, height = spec.size
    parts: list[Part] = []
    for k in range(min(spec.count, 6)):
        scale = float(rng.uniform(0.5, 1.0))
        half = (length / 2 * scale, width / 2 * float(rng.uniform(0.6, 1.0)), height / 2 * float(rng.uniform(0.5, 1.0)))
        if k % 2 == 1:  # on top of the one before
            below = parts[-1]
            half = (min(half[0], below.size[0]), min(half[1], below.size[1]), half[2])
            centre = (below.centre[0], below.centre[1], below.centre[2] + below.size[2] + half[2])
        else:
            centre = (float(rng.normal(0.0, 0.05)), (k // 2) * width * 1.15, half[2])
        parts.append(Part(centre, half, yaw=float(rng.normal(0.0, 0.2)), look_shift=k))
    return parts


def _column(spec: Extent, rng: np.random.Generator) -> list[Part]:
    radius, _, height = spec.size
    foot = Part((0.0, 0.0, 0.06), (radius * 0.75, radius * 0.75, 0.06))
    return [foot, Part((0.0, 0.0, height / 2), (radius / 2, height / 2, 0.0), kind="cylinder")]


_BUILDERS: dict[str, tuple[Builder, bool]] = {  # and whether it collides
    "crosswalk": (_crosswalk, False),
    "floor_stripes": (_floor_stripes, False),
    "tile_seams": (_tile_seams, False),
    "mat": (_mat, False),
    "planks": (_planks, True),
    "shelf": (_shelf, True),
    "ramp": (_ramp, True),
    "fence": (_fence, True),
    "blinds": (_blinds, True),
    "bench": (_bench, True),
    "boxes": (_boxes, True),
    "column": (_column, True),
    **LOOK_ALIKES,
    **CLUTTER,
}
DISTRACTOR_KINDS: tuple[str, ...] = tuple(_BUILDERS)
FLAT_KINDS: tuple[str, ...] = tuple(kind for kind, (_, collides) in _BUILDERS.items() if not collides)
