"""Marks across a whole scene that no texture holds: shadows of what is out of sight, trodden lanes, damp patches, dirt.

All are functions of the place in the world, so that a shadow's border or a lane goes on from step to step as it does in
life: straight lines on stairs that are no stair lines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from stair_env.common.field_kinds import naming_fields
from stair_env.common.validation import SpecError, check_range

Pair = tuple[float, float]


def _check_pair(spec: object, name: str, low: float, high: float) -> None:
    """Turn a field into two floats in [low, high]."""
    values = tuple(float(value) for value in getattr(spec, name))
    if len(values) != 2:
        raise SpecError(f"{name}={values!r} must be two numbers")
    for value in values:
        check_range(name, value, low, high)
    object.__setattr__(spec, name, values)


@dataclass(frozen=True)
class LightPattern:
    """What stands in the light's way, out of sight: a railing, blinds, a window's frame, leaves.

    Two families of parallel bars cross at right angles in the plane across the light's direction (below a lamp: in the
    horizontal plane 2.5 m below it).

    Args:
        angle_rad: turn of the bars in that plane.
        period_m: from bar to bar of each family, metres.
        shade: share of each period that lies in shade, 0 (no bars) to 1.
        phase: place of the first bar of each family, periods.
        softness: width of the half-shadow, periods.
        warp: how far bars are bent, periods; from about 0.5 on they look like foliage.
        strength: share of the light that bars take, 0 to 0.97.

    Raises:
        SpecError: a field is out of range.
    """

    angle_rad: float = 0.0
    period_m: Pair = (0.12, 1.0)
    shade: Pair = (0.3, 0.0)
    phase: Pair = (0.0, 0.0)
    softness: float = 0.05
    warp: float = 0.0
    strength: float = 0.8

    @naming_fields
    def __post_init__(self) -> None:
        check_range("angle_rad", self.angle_rad, -2 * math.pi, 2 * math.pi)
        _check_pair(self, "period_m", 0.02, 50.0)
        _check_pair(self, "shade", 0.0, 1.0)
        _check_pair(self, "phase", 0.0, 1.0)
        check_range("softness", self.softness, 0.005, 1.0)
        check_range("warp", self.warp, 0.0, 3.0)
        check_range("strength", self.strength, 0.0, 0.97)


@dataclass(frozen=True)
class Soiling:
    """Where surfaces are trodden, damp or dirty.

    Args:
        lane_gain: how much lighter (negative: darker) treads and floors are in the middle of the lane that is walked.
        lane_y: its middle, metres.
        lane_half_width: where it ends, metres.
        patch_strength: how much darker patches are, 0 to 1; negative ones are lighter.
        patch_period_m: mean distance of patches along x and y, metres.
        patch_phase: where they lie, periods.
        patch_share: how much of the surface they take, 0 to 1.
        wetness: gloss that patches add, 0 to 1.
        grime: how much darker inner edges and corners are by the dirt in them, 0 to 1; negative: dust, lighter.

    Raises:
        SpecError: a field is out of range.
    """

    lane_gain: float = 0.0
    lane_y: float = 0.0
    lane_half_width: float = 0.4
    patch_strength: float = 0.0
    patch_period_m: Pair = (1.5, 1.5)
    patch_phase: Pair = (0.0, 0.0)
    patch_share: float = 0.3
    wetness: float = 0.0
    grime: float = 0.0

    @naming_fields
    def __post_init__(self) -> None:
        check_range("lane_gain", self.lane_gain, -0.8, 1.0)
        check_range("lane_y", self.lane_y, -5.0, 5.0)
        check_range("lane_half_width", self.lane_half_width, 0.05, 5.0)
        check_range("patch_strength", self.patch_strength, -1.0, 0.95)
        _check_pair(self, "patch_period_m", 0.1, 50.0)
        _check_pair(self, "patch_phase", 0.0, 1.0)
        check_range("patch_share", self.patch_share, 0.0, 1.0)
        check_range("wetness", self.wetness, 0.0, 1.0)
        check_range("grime", self.grime, -0.5, 0.95)
