"""Procedural textures of building materials: square, tileable, the same for the same seed."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stair_env.common.validation import check_choice
from stair_env.scene.materials.coverings import COVERINGS
from stair_env.scene.materials.texture_fields import (
    TEXTURE_SIZE_PX,
    Colour,
    Finish,
    grid,
    hsv_colour,
    mix,
    noise,
    paint_chips,
    pick_colour,
    ramp,
    seams,
)
from stair_env.scene.materials.wear import worn

TEXTURE_CACHE = 128  # textures kept, 200 kB each


@dataclass(frozen=True, eq=False)
class Texture:
    """A square piece of a material.

    Attributes:
        albedo: (256, 256, 3) uint8, sRGB, read-only. Columns run along a surface's longer horizontal direction (the
            grain of wood, the courses of brick), rows across it.
        metres_per_tile: edge length of the square, metres.
        specular: strength of the mirror-like part of the reflection, 0 to 1.
        shininess: exponent of its lobe (Blinn), from 4 (satin) to 120 (polish).
        depth_dropout: how readily a stereo depth camera loses this material (mirror-like, black or without texture),
            0 to 1. Judged by hand from what the D435i's makers name as hard surfaces.
    """

    albedo: np.ndarray
    metres_per_tile: float
    specular: float
    shininess: float
    depth_dropout: float


CONCRETES: tuple[Colour, ...] = (
    (0.62, 0.61, 0.59),
    (0.55, 0.55, 0.54),
    (0.68, 0.66, 0.61),
    (0.48, 0.47, 0.45),
    (0.58, 0.60, 0.61),
)


STAIN = np.array([0.84, 0.81, 0.77], np.float32)


def _concrete(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    base = pick_colour(rng, CONCRETES)
    cloud = noise(rng, 1, 24, 1.1)
    stain = noise(rng, 1, 40, 1.4)
    grain = noise(rng, 30, 128, 0.2)
    pores = ramp(2.9, noise(rng, 18, 70, 0.0), 0.5)
    image = base * (1 + 0.03 * cloud + 0.035 * grain)[..., None]
    image = mix(image, image * STAIN, ramp(1.0, stain, 2.4) * float(rng.uniform(0.1, 0.7)))
    image = mix(image, image * 0.5, pores * float(rng.uniform(0.2, 0.9)))
    return image, Finish(0.9, 0.04, 8.0, 0.03)


def _terrazzo(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    base = pick_colour(
        rng, ((0.78, 0.76, 0.72), (0.60, 0.59, 0.57), (0.36, 0.36, 0.37), (0.70, 0.62, 0.55), (0.55, 0.60, 0.57))
    )
    chips = np.array(
        [
            (0.90, 0.89, 0.85),
            (0.25, 0.24, 0.24),
            (0.55, 0.42, 0.33),
            (0.45, 0.47, 0.46),
            (0.72, 0.60, 0.47),
            (0.62, 0.30, 0.24),
        ],
        np.float32,
    )
    image = base * (1 + 0.015 * noise(rng, 1, 12, 1.2) + 0.02 * noise(rng, 40, 128, 0.0))[..., None]
    chosen = chips[rng.choice(len(chips), size=int(rng.integers(2, 5)), replace=False)]
    coarse = float(rng.uniform(0.0, 1.0))
    image = np.ascontiguousarray(image, np.float32)
    paint_chips(rng, image, chosen, 420, (0.8, 2.2))
    paint_chips(rng, image, chosen, int(150 + 90 * coarse), (2.0, 5.0))
    paint_chips(rng, image, chosen, int(40 * coarse), (5.0, 9.0))
    return image * (1 + 0.012 * noise(rng, 1, 30, 0.8))[..., None], Finish(0.4, 0.35, 60.0, 0.15)


WOODS: tuple[tuple[Colour, Colour], ...] = (  # light and dark part of the grain
    ((0.76, 0.58, 0.38), (0.55, 0.37, 0.20)),  # oak
    ((0.86, 0.70, 0.49), (0.71, 0.52, 0.32)),  # pine
    ((0.47, 0.30, 0.18), (0.28, 0.16, 0.09)),  # walnut
    ((0.55, 0.28, 0.16), (0.35, 0.15, 0.08)),  # cherry
    ((0.82, 0.72, 0.57), (0.68, 0.56, 0.41)),  # beech
    ((0.56, 0.52, 0.47), (0.38, 0.34, 0.30)),  # weathered
)


def _wood(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    light, dark = WOODS[int(rng.integers(len(WOODS)))]
    boards = int(rng.choice([4, 6, 8])) if patterned else 1
    rows, _ = grid()
    board = np.minimum((rows * boards).astype(np.int32), boards - 1)
    slow = noise(rng, 0.9, 10, 1.6, stretch=6.0)
    rings = np.sin(2 * np.pi * (int(rng.integers(5, 11)) * rows) + 2.4 * slow)
    fibre = noise(rng, 24, 200, 0.4, stretch=22.0)
    pores = noise(rng, 70, 400, 0.0, stretch=24.0)
    weight = 0.45 + 0.22 * rings + 0.13 * fibre + 0.1 * slow
    if boards > 1:  # each board was cut from another place
        shift = rng.integers(0, TEXTURE_SIZE_PX, boards)
        columns = (np.arange(TEXTURE_SIZE_PX)[None, :] + shift[board[:, :1]]) % TEXTURE_SIZE_PX
        weight = np.take_along_axis(weight, columns, axis=1)
    tone = rng.normal(1.0, 0.07, boards).astype(np.float32)[board]
    image = mix(light, dark, weight) * tone[..., None]
    image = mix(image, image * 0.7, ramp(1.6, pores, 1.2) * 0.5)
    if boards > 1:
        image *= seams(rows, boards, 0.006)[..., None]
        image *= _butt_joints(rng, board, boards)[..., None]
    scale = 0.12 * boards if boards > 1 else 0.7
    return image, Finish(scale, float(rng.uniform(0.08, 0.3)), 30.0, 0.06)


def _butt_joints(rng: np.random.Generator, board: np.ndarray, boards: int) -> np.ndarray:
    """Where boards end: one joint per board, at a place of its own."""
    _, columns = grid()
    return seams((columns + rng.random(boards).astype(np.float32)[board]) % 1.0, 1, 0.006)


def _tile(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    count = int(rng.choice([2, 3, 4, 6]))
    edge_m = {2: 0.45, 3: 0.3, 4: 0.2, 6: 0.1}[count]
    rows, columns = grid()
    base = pick_colour(
        rng,
        (
            (0.80, 0.78, 0.74),
            (0.66, 0.58, 0.49),
            (0.45, 0.46, 0.48),
            (0.60, 0.36, 0.27),
            (0.85, 0.85, 0.84),
            (0.52, 0.56, 0.55),
        ),
    )
    other = base * 0.55 if patterned and rng.random() < 0.5 else base  # a chequerboard
    cell_row, cell_column = (rows * count).astype(np.int32), (columns * count).astype(np.int32)
    odd = ((cell_row + cell_column) % 2).astype(np.float32) if count % 2 == 0 else np.zeros_like(rows)
    image = mix(base, other, odd)
    tone = rng.normal(1.0, 0.03, (count, count)).astype(np.float32)[cell_row % count, cell_column % count]
    vein = 1 - np.abs(noise(rng, 1, 20, 1.5))
    image = image * (tone * (1 + 0.02 * noise(rng, 2, 60, 0.9)))[..., None]
    image = mix(image, image * 0.8, ramp(0.9, vein, 0.25) * float(rng.uniform(0.0, 0.6)))
    joint = 0.004 / (edge_m * count)  # 4 mm
    distance = np.minimum(np.abs((rows * count + 0.5) % 1.0 - 0.5), np.abs((columns * count + 0.5) % 1.0 - 0.5)) / count
    grout = pick_colour(rng, ((0.45, 0.44, 0.42), (0.70, 0.69, 0.66), (0.28, 0.27, 0.27)))
    image = image * (0.9 + 0.1 * ramp(2.2 * joint, distance, 2 * joint))[..., None]
    image = mix(
        grout * (1 + 0.06 * noise(rng, 20, 128, 0.3))[..., None], image, ramp(joint, distance, 0.7 * joint + 0.003)
    )
    return image, Finish(edge_m * count, float(rng.uniform(0.15, 0.5)), 70.0, 0.2)


def _brick(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    courses, bricks = 8, 3  # of 240 x 71 mm with 10 mm joints: 0.75 m wide, 0.6 m high, close to square
    rows, columns = grid()
    course = (rows * courses).astype(np.int32)
    along = columns * bricks + (0.5 * (course % 2)).astype(np.float32)
    brick = along.astype(np.int32) % bricks
    base = pick_colour(
        rng, ((0.58, 0.30, 0.22), (0.50, 0.25, 0.19), (0.66, 0.45, 0.32), (0.45, 0.40, 0.37), (0.72, 0.60, 0.45))
    )
    tone = rng.normal(1.0, 0.11, (courses, bricks)).astype(np.float32)[course, brick]
    hue = rng.normal(0.0, 0.02, (courses, bricks)).astype(np.float32)[course, brick]
    image = base * tone[..., None] + hue[..., None] * np.array([1.0, 0.1, -0.6], np.float32)
    image = image * (1 + 0.06 * noise(rng, 8, 128, 0.5) + 0.05 * noise(rng, 2, 20, 1.0))[..., None]
    wobble = 0.012 * noise(rng, 6, 60, 0.8)
    to_bed = np.abs((rows * courses + 0.5) % 1.0 - 0.5) * 0.081
    to_head = np.abs((along + 0.5) % 1.0 - 0.5) * 0.25
    distance = np.minimum(to_bed, to_head) * (1 + wobble * 6)
    mortar = pick_colour(rng, ((0.66, 0.64, 0.60), (0.52, 0.50, 0.47), (0.75, 0.73, 0.69)))
    mortar_image = mortar * (1 + 0.07 * noise(rng, 20, 128, 0.2))[..., None]
    image = image * (0.82 + 0.18 * ramp(0.008, distance, 0.006))[..., None]
    return mix(mortar_image, image, ramp(0.005, distance, 0.004)), Finish(0.7, 0.02, 6.0, 0.02)


def _metal(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    base = pick_colour(rng, ((0.62, 0.63, 0.65), (0.50, 0.52, 0.54), (0.35, 0.37, 0.39), (0.68, 0.66, 0.62)))
    brushed = noise(rng, 10, 300, 0.2, stretch=30.0)
    image = base * (1 + 0.035 * brushed + 0.03 * noise(rng, 1, 6, 1.0))[..., None]
    if patterned:  # chequer plate: lens-shaped studs, alternately along both diagonals
        image = image * _chequer_plate(8)[..., None]
    rust = float(rng.uniform(0.0, 0.7)) * (rng.random() < 0.3)
    spots = ramp(1.6, noise(rng, 1, 60, 1.1), 0.8)
    image = mix(image, np.array([0.42, 0.24, 0.13], np.float32), spots * rust)
    return image, Finish(0.4, 0.55, 40.0, 0.45)


def _chequer_plate(count: int) -> np.ndarray:
    """Shading factor of count x count studs on a plate."""
    rows, columns = grid()
    y, x = rows * count % 1.0 - 0.5, columns * count % 1.0 - 0.5
    turn = np.where(((rows * count).astype(int) + (columns * count).astype(int)) % 2 == 0, 1.0, -1.0)
    along, across = (x + turn * y) / np.sqrt(2), (x - turn * y) / np.sqrt(2)
    height = np.clip(1 - (along / 0.42) ** 2 - (across / 0.13) ** 2, 0, 1)
    lit = np.gradient(np.sqrt(height), axis=0) * -1.2
    shaded: np.ndarray = (0.92 + 0.16 * ramp(0.05, height, 0.1) + np.clip(lit, -0.25, 0.35)).astype(np.float32)
    return shaded


ACCENTS: tuple[Colour, ...] = ((0.05, 0.05, 0.06), (0.10, 0.07, 0.02), (0.02, 0.05, 0.10), (0.10, 0.02, 0.02))


def _carpet(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    base = np.asarray(hsv_colour(rng, (0.0, 1.0, 0), (0.05, 0.42, 0), (0.25, 0.55, 0)), np.float32)
    pile = noise(rng, 40, 128, 0.1)
    loops = noise(rng, 60, 100, 0.0)
    image = base * (1 + 0.13 * pile + 0.07 * loops + 0.03 * noise(rng, 1, 10, 1.0))[..., None]
    rows, columns = grid()
    accent = base * float(rng.uniform(0.45, 0.75) if base.max() > 0.4 else rng.uniform(1.4, 2.0)) + pick_colour(
        rng, ACCENTS
    )
    accent_image = accent * (1 + 0.14 * pile)[..., None]
    style = int(rng.integers(3)) if patterned else -1
    if style == 0:  # stripes
        image = mix(image, accent_image, ramp(0.75, np.cos(2 * np.pi * 4 * columns), 0.15))
    elif style == 1:  # dots
        image = mix(
            image, accent_image, ramp(0.62, np.cos(2 * np.pi * 5 * columns) * np.cos(2 * np.pi * 5 * rows), 0.15)
        )
    elif style == 2:  # flecks
        image = mix(image, accent_image, ramp(1.3, noise(rng, 20, 90, 0.2), 0.4) * 0.8)
    return image, Finish(0.5, 0.0, 4.0, 0.05)


def _painted(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Near white, so that a tint decides the colour."""
    roller = noise(rng, 30, 128, 0.2)
    image = np.array([0.92, 0.92, 0.91], np.float32) * (1 + 0.012 * roller + 0.012 * noise(rng, 1, 8, 1.0))[..., None]
    scuff = ramp(2.1, noise(rng, 3, 128, 0.7, stretch=5.0), 0.8) * float(rng.uniform(0.0, 0.35))
    return mix(image, image * 0.72, scuff), Finish(1.2, float(rng.uniform(0.02, 0.2)), 20.0, 0.3)


PAINTERS: dict[str, Callable[[np.random.Generator, bool], tuple[np.ndarray, Finish]]] = {
    "concrete": _concrete,
    "terrazzo": _terrazzo,
    "wood": _wood,
    "tile": _tile,
    "brick": _brick,
    "metal": _metal,
    "carpet": _carpet,
    "painted": _painted,
    **COVERINGS,
}
MATERIALS: tuple[str, ...] = tuple(PAINTERS)


@functools.lru_cache(maxsize=TEXTURE_CACHE)
def make_texture(material: str, seed: int, wear: int = 0) -> Texture:
    """One specimen of a material; the same arguments give the same texture.

    Args:
        material: one of MATERIALS.
        seed: which specimen, 0 or more. Odd ones are patterned where the material knows patterns: floor boards instead
            of one slab of wood, chequer plate, chequered tiles, striped carpet.
        wear: how used it is, one of `stair_env.scene.materials.wear.WEAR_LEVELS`; 0 is new.

    Raises:
        SpecError: no such material.
    """
    check_choice("material", material, MATERIALS)
    rng = np.random.default_rng([MATERIALS.index(material), seed])
    image, finish = PAINTERS[material](rng, seed % 2 == 1)
    image = worn(rng, image, wear)
    albedo = (np.clip(image, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
    albedo.setflags(write=False)
    return Texture(albedo, *finish)
