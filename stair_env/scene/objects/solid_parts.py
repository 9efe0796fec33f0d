"""What distractors are made of: solids in a distractor's own frame (x forward, y left, z up, origin on the floor)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from stair_env.scene.shapes import ShapeKind, Vector3

PAINT_THICKNESS_M = 0.002  # of what is painted or stuck on: a depth camera cannot tell it from the floor


class Extent(Protocol):
    """The part of a `stair_env.scene.objects.distractors.DistractorSpec` that a builder reads."""

    @property
    def size(self) -> Vector3:
        """Extent along x, y and z, metres."""

    @property
    def count(self) -> int:
        """Number of repeated parts."""


@dataclass(frozen=True)
class Part:
    """A solid in the distractor's own frame.

    Attributes:
        centre, size, kind: as of a `stair_env.scene.Shape`.
        pitch, yaw: turns about y, then about z, radians.
        look_shift: added to the distractor's own look.
        look: number of a look in the palette, instead of the distractor's own; see `stair_env.scene.objects.palette`.
    """

    centre: Vector3
    size: Vector3
    pitch: float = 0.0
    yaw: float = 0.0
    kind: ShapeKind = "box"
    look_shift: int = 0
    look: int | None = None


Builder = Callable[[Extent, np.random.Generator], list[Part]]


def box(low: Vector3, high: Vector3, look_shift: int = 0, look: int | None = None) -> Part:
    """Box between two corners, metres."""
    centre = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2)
    half = ((high[0] - low[0]) / 2, (high[1] - low[1]) / 2, (high[2] - low[2]) / 2)
    return Part(centre, half, look_shift=look_shift, look=look)


def bar(
    start: Vector3,
    end: Vector3,
    radius: float,
    kind: ShapeKind = "cylinder",
    look_shift: int = 0,
    look: int | None = None,
) -> Part:
    """Cylinder or capsule between two points, metres."""
    dx, dy, dz = (b - a for a, b in zip(start, end))
    flat = math.hypot(dx, dy)
    centre = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2, (start[2] + end[2]) / 2)
    half = math.hypot(flat, dz) / 2
    return Part(centre, (radius, half, 0.0), math.atan2(flat, dz), math.atan2(dy, dx), kind, look_shift, look)


def upright(
    x: float, y: float, low: float, high: float, radius: float, look: int | None = None, shift: int = 0
) -> Part:
    """Standing cylinder, metres."""
    return Part((x, y, (low + high) / 2), (radius, (high - low) / 2, 0.0), kind="cylinder", look_shift=shift, look=look)
