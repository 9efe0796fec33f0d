"""Painters of what stairs, floors and walls are covered with besides the plain building materials.

Each takes the generator and whether the specimen is of the patterned kind, and returns a (256, 256, 3) float sRGB image
that tiles, and its finish.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stair_env.scene.materials.texture_fields import (
    TEXTURE_SIZE_PX,
    Finish,
    cells,
    grid,
    hsv_colour,
    mix,
    noise,
    paint_chips,
    pick_colour,
    ramp,
    seams,
)

Painter = Callable[[np.random.Generator, bool], tuple[np.ndarray, Finish]]

DARK_GROUT = (0.30, 0.29, 0.28)


def _shaded(height: np.ndarray, strength: float) -> np.ndarray:
    """Factor by which a relief is lighter on its upper flank and darker on its lower one."""
    slope = np.roll(height, 1, axis=0) - np.roll(height, -1, axis=0)
    factor: np.ndarray = 1 + np.clip(-strength * slope, -0.45, 0.45)
    return factor


def _rubber(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Studded or, patterned, ribbed flooring."""
    base = pick_colour(rng, ((0.16, 0.16, 0.17), (0.30, 0.31, 0.33), (0.20, 0.28, 0.38), (0.45, 0.20, 0.16)))
    rows, columns = grid()
    if patterned:
        height = ramp(0.0, np.cos(2 * np.pi * 12 * rows), 0.6)
    else:
        count = 8
        distance = np.hypot(rows * count % 1.0 - 0.5, columns * count % 1.0 - 0.5)
        height = 1 - ramp(0.33, distance, 0.08)
    image = base * (1 + 0.05 * noise(rng, 20, 128, 0.2) + 0.04 * noise(rng, 1, 12, 1.0))[..., None]
    return image * ((0.9 + 0.16 * height) * _shaded(height, 0.45))[..., None], Finish(0.28, 0.12, 14.0, 0.3)


def _granite(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Crystals of three minerals; patterned: sawn slabs with joints."""
    base = pick_colour(rng, ((0.66, 0.65, 0.64), (0.45, 0.44, 0.44), (0.62, 0.50, 0.44), (0.24, 0.25, 0.27)))
    image: np.ndarray = np.ones((TEXTURE_SIZE_PX, TEXTURE_SIZE_PX, 3), np.float32) * base
    grey = float(base.mean())
    minerals = np.array([base * 0.45, base * 0.75, np.minimum(base * 1.3 + 0.06, 0.95), [grey, grey * 0.9, grey * 0.8]])
    paint_chips(rng, image, minerals.astype(np.float32), 2600, (0.7, 2.0))
    image = image * (1 + 0.05 * noise(rng, 40, 128, 0.0) + 0.03 * noise(rng, 1, 8, 1.2))[..., None]
    if patterned:
        rows, columns = grid()
        image = image * (seams(rows, 1, 0.012) * seams(columns, 1, 0.012))[..., None]
    return image, Finish(0.6, float(rng.uniform(0.1, 0.4)), 50.0, 0.12)


def _marble(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    base = pick_colour(rng, ((0.88, 0.87, 0.85), (0.80, 0.75, 0.66), (0.34, 0.38, 0.36), (0.70, 0.52, 0.46)))
    warp = noise(rng, 1, 10, 1.4)
    vein = np.abs(noise(rng, 1, 14, 1.3) + 0.35 * warp)
    fine = np.abs(noise(rng, 3, 40, 1.1))
    dark = base * (0.55 if base.mean() > 0.5 else 1.7) + np.array([0.02, 0.0, -0.02], np.float32)
    image = base * (1 + 0.03 * warp)[..., None]
    image = mix(image, dark, (1 - ramp(0.10, vein, 0.2)) * float(rng.uniform(0.3, 0.8)))
    image = mix(image, dark, (1 - ramp(0.06, fine, 0.12)) * float(rng.uniform(0.1, 0.4)))
    if patterned:
        rows, columns = grid()
        image = image * (seams(rows, 2, 0.005, 0.4) * seams(columns, 2, 0.005, 0.4))[..., None]
    return image, Finish(1.0, float(rng.uniform(0.3, 0.6)), 90.0, 0.25)


def _grating(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Bar grating, or patterned: sheet with round holes. What shows through is dark."""
    base = pick_colour(rng, ((0.60, 0.61, 0.62), (0.46, 0.47, 0.49), (0.33, 0.31, 0.29)))
    rows, columns = grid()
    if patterned:
        y, x = rows * 12, columns * 12
        x = x + 0.5 * (y.astype(np.int32) % 2)
        solid = ramp(0.30, np.hypot(x % 1.0 - 0.5, y % 1.0 - 0.5), 0.1)
    else:
        bars = 1 - ramp(0.14, np.abs(columns * 12 % 1.0 - 0.5), 0.08)
        rods = 1 - ramp(0.10, np.abs(rows * 4 % 1.0 - 0.5), 0.06)
        solid = np.maximum(bars, rods)
    steel = base * (1 + 0.08 * noise(rng, 2, 128, 0.4))[..., None]
    return mix(steel * 0.16, steel * _shaded(solid, 0.3)[..., None], solid), Finish(0.36, 0.35, 30.0, 0.4)


def _paving(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Setts in courses; patterned: crazy paving of broken slabs."""
    base = pick_colour(rng, ((0.52, 0.50, 0.47), (0.42, 0.42, 0.43), (0.60, 0.50, 0.42), (0.64, 0.61, 0.55)))
    number, border = cells(rng, 5 if patterned else 8, jitter=0.42 if patterned else 0.16)
    tone = rng.normal(1.0, 0.10, number.max() + 1).astype(np.float32)[number]
    image = base * (tone * (1 + 0.07 * noise(rng, 10, 128, 0.4) + 0.05 * noise(rng, 1, 10, 1.0)))[..., None]
    joint = pick_colour(rng, ((0.36, 0.34, 0.30), (0.55, 0.52, 0.47), (0.22, 0.26, 0.16)))
    filling = joint * (1 + 0.12 * noise(rng, 20, 128, 0.2))[..., None]
    image = image * (0.8 + 0.2 * ramp(0.16, border, 0.2))[..., None]
    return mix(filling, image, ramp(0.07, border, 0.05)), Finish(1.6 if patterned else 0.9, 0.03, 8.0, 0.03)


LEAVES = np.array(
    [(0.55, 0.36, 0.14), (0.62, 0.48, 0.16), (0.38, 0.22, 0.10), (0.45, 0.42, 0.15), (0.28, 0.18, 0.09)], np.float32
)


def _stone(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Weathered stone with lichen and moss; patterned: with fallen leaves on it."""
    base = pick_colour(rng, ((0.56, 0.53, 0.48), (0.46, 0.45, 0.43), (0.66, 0.58, 0.46), (0.38, 0.37, 0.36)))
    relief = noise(rng, 2, 90, 0.9)
    image = base * ((1 + 0.05 * relief + 0.05 * noise(rng, 30, 128, 0.2)) * _shaded(relief, 0.1))[..., None]
    lichen = ramp(1.2, noise(rng, 4, 60, 0.7), 0.5) * float(rng.uniform(0.0, 0.7))
    image = mix(image, pick_colour(rng, ((0.70, 0.70, 0.60), (0.62, 0.58, 0.30), (0.34, 0.34, 0.32))), lichen)
    moss = ramp(0.8, noise(rng, 1, 50, 0.9), 1.0) * float(rng.uniform(0.0, 0.9))
    green = pick_colour(rng, ((0.25, 0.32, 0.13), (0.34, 0.38, 0.18)))
    image = mix(image, green * (1 + 0.2 * noise(rng, 30, 128, 0.1))[..., None], moss)
    if patterned:
        image = np.ascontiguousarray(image, np.float32)
        paint_chips(rng, image, LEAVES, int(rng.integers(15, 90)), (3.0, 8.0))
    return image, Finish(1.1, 0.02, 6.0, 0.02)


def _slab_tile(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Oblong tiles laid half over half, from mosaic to planks; patterned: two tones."""
    courses, per_course, height_m = ((2, 1, 0.30), (4, 2, 0.10), (8, 1, 0.15), (8, 8, 0.025))[int(rng.integers(4))]
    rows, columns = grid()
    course = (rows * courses).astype(np.int32)
    along = columns * per_course + (0.5 if per_course < 8 else 0.0) * (course % 2)
    tile = along.astype(np.int32) % per_course
    base = pick_colour(
        rng, ((0.82, 0.80, 0.76), (0.60, 0.55, 0.48), (0.38, 0.39, 0.41), (0.55, 0.62, 0.66), (0.66, 0.48, 0.36))
    )
    spread = 0.12 if patterned else 0.03
    tone = rng.normal(1.0, spread, (courses, per_course)).astype(np.float32)[course, tile]
    image = base * (tone * (1 + 0.03 * noise(rng, 1, 60, 1.0)))[..., None]
    side_m = height_m * courses
    to_bed = np.abs((rows * courses + 0.5) % 1.0 - 0.5) * height_m
    to_head = np.abs((along + 0.5) % 1.0 - 0.5) * side_m / per_course
    joint = max(0.002, 0.004 * side_m)
    grout = pick_colour(rng, ((0.48, 0.47, 0.45), (0.74, 0.73, 0.70), DARK_GROUT))
    solid = ramp(joint, np.minimum(to_bed, to_head), joint)
    return mix(grout, image, solid), Finish(side_m, float(rng.uniform(0.1, 0.5)), 60.0, 0.2)


def _parquet(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Basket weave, or patterned: strips laid in a brick bond."""
    light = pick_colour(rng, ((0.72, 0.54, 0.35), (0.58, 0.38, 0.23), (0.42, 0.27, 0.17), (0.80, 0.66, 0.48)))
    rows, columns = grid()
    fibre_along, fibre_across = noise(rng, 20, 200, 0.4, stretch=18.0), noise(rng, 20, 200, 0.4, stretch=18.0).T
    if patterned:
        strips, across, along = 8, rows * 8, columns * 2 + 0.5 * ((rows * 8).astype(np.int32) % 2)
        strip = across.astype(np.int32) * 2 + along.astype(np.int32) % 2
        weight, edge = fibre_along, np.minimum(_to_border(across), 4 * _to_border(along))
        tones, side_m = strips * 2, 0.56
    else:
        blocks = 4
        turned = ((rows * blocks).astype(np.int32) + (columns * blocks).astype(np.int32)) % 2 == 1
        across = np.where(turned, columns, rows) * blocks * 4
        along = np.where(turned, rows, columns) * blocks
        block = (rows * blocks).astype(np.int32) * blocks + (columns * blocks).astype(np.int32)
        strip = block * 4 + across.astype(np.int32) % 4
        weight = np.where(turned, fibre_across, fibre_along)
        edge = np.minimum(_to_border(across), 4 * _to_border(along))
        tones, side_m = blocks * blocks * 4, 0.8
    tone = rng.normal(1.0, 0.08, tones).astype(np.float32)[strip % tones]
    image = light * (tone * (1 + 0.06 * weight))[..., None]
    return image * (0.6 + 0.4 * ramp(0.05, edge, 0.07))[..., None], Finish(
        side_m, float(rng.uniform(0.1, 0.4)), 40.0, 0.08
    )


def _to_border(position: np.ndarray) -> np.ndarray:
    """Distance to the nearest whole number."""
    distance: np.ndarray = np.abs((position + 0.5) % 1.0 - 0.5)
    return distance


def _asphalt(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Patterned: with cracks and patches."""
    base = pick_colour(rng, ((0.30, 0.30, 0.31), (0.22, 0.22, 0.23), (0.42, 0.41, 0.40)))
    image: np.ndarray = np.ascontiguousarray(base * (1 + 0.05 * noise(rng, 1, 20, 1.0))[..., None], np.float32)
    paint_chips(rng, image, np.array([base * 0.6, base * 1.3, base * 1.7], np.float32), 1500, (0.7, 1.7))
    image = image * (1 + 0.08 * noise(rng, 50, 128, 0.0))[..., None]
    if patterned:
        crack = np.abs(noise(rng, 1, 30, 1.2))
        image = mix(image, image * 0.4, 1 - ramp(0.03, crack, 0.05))
    return image, Finish(0.7, 0.05, 10.0, 0.05)


def _grass(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Patterned: dry, with bare earth."""
    green = np.asarray(hsv_colour(rng, (0.18, 0.30, 0), (0.35, 0.65, 0), (0.25, 0.45, 0)), np.float32)
    blades = noise(rng, 30, 128, 0.1)
    image = green * (1 + 0.28 * blades + 0.10 * noise(rng, 2, 30, 0.8))[..., None]
    if patterned:
        earth = np.array([0.42, 0.33, 0.23], np.float32) * (1 + 0.12 * noise(rng, 20, 128, 0.2))[..., None]
        image = mix(image, earth, ramp(0.4, noise(rng, 1, 30, 0.9), 1.0))
    return image, Finish(1.2, 0.0, 4.0, 0.03)


def _linoleum(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Marbled along its length; patterned: flecked."""
    base = np.asarray(hsv_colour(rng, (0.0, 1.0, 0), (0.03, 0.30, 0), (0.35, 0.75, 0)), np.float32)
    other = base * float(rng.uniform(0.7, 0.9))
    image = mix(base, other, 0.5 + 0.35 * noise(rng, 2, 60, 0.8, stretch=3.0))
    if patterned:
        image = np.ascontiguousarray(image, np.float32)
        paint_chips(rng, image, np.stack([base * 0.55, np.minimum(base * 1.35, 0.97)]), 700, (0.6, 1.8))
    return image, Finish(0.8, float(rng.uniform(0.1, 0.35)), 35.0, 0.25)


def _decking(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Grooved boards with gaps between them; patterned: smooth ones."""
    light = pick_colour(rng, ((0.55, 0.45, 0.34), (0.50, 0.48, 0.45), (0.42, 0.28, 0.19), (0.36, 0.37, 0.36)))
    boards = 4
    rows, _ = grid()
    board = np.minimum((rows * boards).astype(np.int32), boards - 1)
    tone = rng.normal(1.0, 0.07, boards).astype(np.float32)[board]
    fibre = noise(rng, 16, 200, 0.4, stretch=20.0)
    image = light * (tone * (1 + 0.09 * fibre + 0.04 * noise(rng, 1, 10, 1.0)))[..., None]
    if not patterned:
        image = image * (0.84 + 0.16 * ramp(-0.2, np.cos(2 * np.pi * boards * 7 * rows), 0.8))[..., None]
    return image * seams(rows, boards, 0.016, 0.8)[..., None], Finish(0.56, 0.06, 12.0, 0.05)


def _siding(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Near white, for a tint: weatherboards that shade one another, or patterned: the ribs of a roller shutter.

    Their long parallel lines with a light and a dark side are what stairs show from afar.
    """
    rows, _ = grid()
    count = 10 if patterned else int(rng.choice([4, 6, 8]))
    place = rows * count % 1.0
    if patterned:
        relief = 0.80 + 0.20 * np.sin(2 * np.pi * place)
    else:
        relief = (0.86 + 0.14 * place) * (0.45 + 0.55 * ramp(0.06, np.minimum(place, 1 - place), 0.06))
    grain = 1 + 0.015 * noise(rng, 20, 200, 0.4, stretch=20.0) + 0.02 * noise(rng, 1, 10, 1.0)
    image = np.array([0.88, 0.88, 0.87], np.float32) * (relief * grain)[..., None]
    return image, Finish(0.8 if patterned else 0.16 * count, float(rng.uniform(0.05, 0.4)), 20.0, 0.25)


def _panelling(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Near white, for a tint: sunk fields in frames, or patterned: large boards with open joints."""
    rows, columns = grid()
    image = np.array([0.86, 0.86, 0.85], np.float32) * (1 + 0.015 * noise(rng, 1, 60, 0.8))[..., None]
    if patterned:
        image = image * (seams(rows, 2, 0.008, 0.7) * seams(columns, 1, 0.006, 0.7))[..., None]
    else:
        across, down = np.abs(columns * 2 % 1.0 - 0.5), np.abs(rows * 2 % 1.0 - 0.5)
        inset = np.maximum(across, down)
        image = image * (1 - 0.3 * (ramp(0.38, inset, 0.02) * (1 - ramp(0.41, inset, 0.02))))[..., None]
    return image, Finish(1.2, float(rng.uniform(0.05, 0.25)), 20.0, 0.25)


COVERINGS: dict[str, Painter] = {
    "rubber": _rubber,
    "granite": _granite,
    "marble": _marble,
    "grating": _grating,
    "paving": _paving,
    "stone": _stone,
    "slab_tile": _slab_tile,
    "parquet": _parquet,
    "asphalt": _asphalt,
    "grass": _grass,
    "linoleum": _linoleum,
    "decking": _decking,
    "siding": _siding,
    "panelling": _panelling,
}
