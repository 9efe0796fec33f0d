"""Random marks across a scene: shadows of what is out of sight, wear, damp, dirt, and where soft light comes from."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from stair_env.scene.marks import LightPattern, Soiling
from stair_env.scene.surroundings import SurroundingsSpec
from stair_env.stairs import StairSpec

SUN_PATTERN_SHARE = 0.45
LAMP_PATTERN_SHARE = 0.15
LANE_SHARE = 0.35
PATCH_SHARE = 0.3
TILT_SHARE = 0.6  # of the scenes have soft light that comes from elsewhere than straight above
MAX_TILT = 0.38


def draw_marks(
    rng: np.random.Generator, light: dict[str, Any], surroundings: SurroundingsSpec, stairs: StairSpec | None
) -> dict[str, Any]:
    """The fields of an AppearanceSpec that lay marks across a scene.

    Args:
        rng: the source of all chance.
        light: fields as from `draw_light`.
        surroundings: decides what can stand in the light's way.
        stairs: whose middle is trodden.
    """
    return {
        "light_pattern": _light_pattern(rng, light, surroundings),
        "soiling": _soiling(rng, surroundings, 1.2 if stairs is None else stairs.flight_width),
        "ambient_tilt": _ambient_tilt(rng),
        "corner_shade": float(rng.uniform(0.2, 0.75)),
    }


def _light_pattern(
    rng: np.random.Generator, light: dict[str, Any], surroundings: SurroundingsSpec
) -> LightPattern | None:
    """A railing, blinds, a window's frame or foliage between the light and the scene."""
    from_lamp = light.get("lamp_position") is not None
    if rng.random() >= (LAMP_PATTERN_SHARE if from_lamp else SUN_PATTERN_SHARE) or not light.get("shadows", True):
        return None
    kinds = (
        ("railing", "frame", "blinds", "foliage") if surroundings.kind != "indoor" else ("railing", "frame", "blinds")
    )
    kind = kinds[int(rng.integers(len(kinds)))]
    u = rng.uniform
    if kind == "railing":  # balusters and a rail
        period, shade = (u(0.09, 0.2), u(0.9, 1.6)), (u(0.12, 0.35), u(0.03, 0.1))
    elif kind == "blinds":
        period, shade = (u(0.04, 0.12), u(0.7, 2.0)), (u(0.35, 0.65), u(0.0, 0.06))
    elif kind == "frame":
        period, shade = (u(0.5, 1.8), u(0.5, 1.8)), (u(0.08, 0.6), u(0.08, 0.6))
    else:
        period, shade = (u(0.15, 0.9), u(0.15, 0.9)), (u(0.2, 0.5), u(0.2, 0.5))
    return LightPattern(
        angle_rad=float(u(-math.pi, math.pi)),
        period_m=period,
        shade=shade,
        phase=(u(0.0, 1.0), u(0.0, 1.0)),
        softness=float(u(0.2, 0.5)) if kind == "foliage" else float(u(0.01, 0.2)),
        warp=float(u(0.3, 0.9)) if kind == "foliage" else 0.0,
        strength=float(u(0.4, 0.95)),
    )


def _soiling(rng: np.random.Generator, surroundings: SurroundingsSpec, width: float) -> Soiling | None:
    """A trodden lane, patches of damp or dust, dirt in the inner edges."""
    u = rng.uniform
    has_lane, has_patches, has_grime = rng.random(3) < (LANE_SHARE, PATCH_SHARE, 0.4)
    if not (has_lane or has_patches or has_grime):
        return None
    outdoors = surroundings.kind != "indoor"
    wet = has_patches and outdoors and rng.random() < 0.5
    strength = float(u(0.2, 0.55)) if wet or rng.random() < 0.7 else -float(u(0.1, 0.5))
    return Soiling(
        lane_gain=float(u(-0.35, 0.35)) if has_lane else 0.0,
        lane_y=float(rng.normal(0.0, 0.12)) * width,
        lane_half_width=float(u(0.25, 0.6)) * width,
        patch_strength=strength if has_patches else 0.0,
        patch_period_m=(float(u(0.5, 3.0)), float(u(0.5, 3.0))),
        patch_phase=(float(u(0.0, 1.0)), float(u(0.0, 1.0))),
        patch_share=float(u(0.1, 0.5)),
        wetness=float(u(0.1, 0.5)) if wet else 0.0,
        grime=(float(u(0.1, 0.8)) if rng.random() < 0.75 else -float(u(0.1, 0.4))) if has_grime else 0.0,
    )


def _ambient_tilt(rng: np.random.Generator) -> tuple[float, float, float]:
    """From above, or from a window, a light wall, a bright floor: then risers may be lighter than treads."""
    if rng.random() >= TILT_SHARE:
        return (0.0, 0.0, 0.22)
    azimuth, elevation = float(rng.uniform(-math.pi, math.pi)), float(rng.uniform(-0.3, math.pi / 2))
    length = MAX_TILT * float(rng.uniform(0.3, 1.0))
    flat = length * math.cos(elevation)
    return (flat * math.cos(azimuth), flat * math.sin(azimuth), length * math.sin(elevation))
