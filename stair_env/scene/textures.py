"""Procedural textures of building materials: square, tileable, the same for the same seed.

Every painter works on tileable fields: noise is filtered in the frequency domain, and cells lie on a jittered grid
that wraps round, so that no seam shows where a texture repeats.
"""

from __future__ import annotations

import colorsys
import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.fft

from stair_env.common.validation import check_choice

TEXTURE_SIZE_PX = 256
TEXTURE_CACHE = 128  # textures kept, 200 kB each

Colour = tuple[float, float, float]  # sRGB, 0 to 1


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


class Finish(NamedTuple):
    """What a painter says of a material besides its colours; see Texture."""

    metres_per_tile: float
    specular: float
    shininess: float
    depth_dropout: float


@functools.lru_cache(maxsize=64)
def _band(low: float, high: float, slope: float, stretch: float) -> np.ndarray:
    """(256, 129) float32 gain of each spatial frequency; see `noise`."""
    rows = np.fft.fftfreq(TEXTURE_SIZE_PX, 1 / TEXTURE_SIZE_PX)
    columns = np.fft.rfftfreq(TEXTURE_SIZE_PX, 1 / TEXTURE_SIZE_PX)
    frequency = np.maximum(np.hypot(rows[:, None], columns[None, :] * stretch), 1e-9)
    gain: np.ndarray = np.where((frequency >= low) & (frequency <= high), frequency**-slope, 0.0).astype(np.float32)
    return gain


def noise(rng: np.random.Generator, low: float, high: float, slope: float = 1.0, stretch: float = 1.0) -> np.ndarray:
    """Tileable Gaussian noise of zero mean and unit variance.

    Args:
        rng: where the phases come from.
        low, high: band in cycles per tile.
        slope: amplitude falls as frequency to the minus slope.
        stretch: how much longer features are along the columns.

    Returns:
        (256, 256) float32.
    """
    # Uniform values do: every filtered value is a sum over many, hence close to Gaussian.
    white = scipy.fft.rfft2(rng.random((TEXTURE_SIZE_PX, TEXTURE_SIZE_PX), dtype=np.float32) - np.float32(0.5))
    field: np.ndarray = scipy.fft.irfft2(white * _band(low, high, slope, stretch), s=(TEXTURE_SIZE_PX, TEXTURE_SIZE_PX))
    return field / max(float(field.std()), 1e-9)


def _paint_chips(
    rng: np.random.Generator, image: np.ndarray, colours: np.ndarray, count: int, radius: tuple[float, float]
) -> None:
    """Paint angular chips of stone into a (256, 256, 3) float32 image, wrapping round its borders.

    Args:
        rng: the source of all chance.
        image: painted in place.
        colours: (k, 3) to choose from.
        count: number of chips.
        radius: (low, high) in pixels.
    """
    import cv2

    corners = 7
    angles = (np.arange(corners) + rng.uniform(-0.38, 0.38, (count, corners))) * (2 * np.pi / corners)
    radii = rng.uniform(*radius, (count, 1)) * rng.uniform(0.65, 1.1, (count, corners))
    outline = np.stack([radii * np.cos(angles), radii * np.sin(angles) * rng.uniform(0.6, 1.0, (count, 1))], axis=-1)
    centre = rng.uniform(0, TEXTURE_SIZE_PX, (count, 1, 2))
    fills = colours[rng.integers(len(colours), size=count)] * rng.uniform(0.85, 1.12, (count, 1))
    wraps = TEXTURE_SIZE_PX * np.array([(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)])
    moved = centre + wraps  # (count, 9, 2)
    margin = 1.2 * radius[1]
    which, wrap = np.nonzero(np.all((moved > -margin) & (moved < TEXTURE_SIZE_PX + margin), axis=-1))
    points = np.round((outline[which] + moved[which, wrap][:, None]) * 16).astype(np.int32)
    for polygon, fill in zip(points, fills[which].tolist()):
        cv2.fillPoly(image, [polygon], fill, lineType=cv2.LINE_AA, shift=4)


@functools.lru_cache(maxsize=1)
def _grid() -> tuple[np.ndarray, np.ndarray]:
    """Row and column coordinates of the pixel centres, each (256, 256) float32 in 0 to 1."""
    axis = (np.arange(TEXTURE_SIZE_PX, dtype=np.float32) + 0.5) / TEXTURE_SIZE_PX
    rows, columns = np.meshgrid(axis, axis, indexing="ij")
    return rows, columns


def _mix(a: np.ndarray | Colour, b: np.ndarray | Colour, weight: np.ndarray) -> np.ndarray:
    """Blend two colours or (256, 256, 3) images by a (256, 256) weight in 0 to 1."""
    share = np.clip(weight, 0.0, 1.0)[..., None]
    first, second = np.asarray(a, np.float32), np.asarray(b, np.float32)
    blended: np.ndarray = first + (second - first) * share
    return blended


def _step(edge: float, value: np.ndarray, width: float) -> np.ndarray:
    """0 below edge, 1 above it, with a smooth ramp of the given width in between."""
    t = np.clip((value - edge) / width + 0.5, 0.0, 1.0)
    smooth: np.ndarray = t * t * (3.0 - 2.0 * t)
    return smooth


def _hsv(rng: np.random.Generator, hue: Colour, saturation: Colour, value: Colour) -> Colour:
    """A random colour; each argument is (low, high, ignored) of one channel."""
    draw = [rng.uniform(low, high) for low, high, _ in (hue, saturation, value)]
    return colorsys.hsv_to_rgb(draw[0] % 1.0, draw[1], draw[2])


def _pick(rng: np.random.Generator, colours: tuple[Colour, ...], jitter: float = 0.04) -> np.ndarray:
    """One of the colours, slightly off, (3,) float32."""
    colour = np.asarray(colours[int(rng.integers(len(colours)))], np.float32)
    warm = 0.4 * jitter * rng.standard_normal()
    shift = 1 + jitter * rng.standard_normal() + np.array([warm, 0.0, -warm])
    picked: np.ndarray = np.clip(colour * shift, 0.02, 0.98).astype(np.float32)
    return picked


CONCRETES: tuple[Colour, ...] = (
    (0.62, 0.61, 0.59),
    (0.55, 0.55, 0.54),
    (0.68, 0.66, 0.61),
    (0.48, 0.47, 0.45),
    (0.58, 0.60, 0.61),
)


STAIN = np.array([0.84, 0.81, 0.77], np.float32)


def _concrete(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    base = _pick(rng, CONCRETES)
    cloud = noise(rng, 1, 24, 1.1)
    stain = noise(rng, 1, 40, 1.4)
    grain = noise(rng, 30, 128, 0.2)
    pores = _step(2.9, noise(rng, 18, 70, 0.0), 0.5)
    image = base * (1 + 0.03 * cloud + 0.035 * grain)[..., None]
    image = _mix(image, image * STAIN, _step(1.0, stain, 2.4) * float(rng.uniform(0.1, 0.7)))
    image = _mix(image, image * 0.5, pores * float(rng.uniform(0.2, 0.9)))
    return image, Finish(0.9, 0.04, 8.0, 0.03)


def _terrazzo(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    base = _pick(
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
    _paint_chips(rng, image, chosen, 420, (0.8, 2.2))
    _paint_chips(rng, image, chosen, int(150 + 90 * coarse), (2.0, 5.0))
    _paint_chips(rng, image, chosen, int(40 * coarse), (5.0, 9.0))
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
    rows, _ = _grid()
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
    image = _mix(light, dark, weight) * tone[..., None]
    image = _mix(image, image * 0.7, _step(1.6, pores, 1.2) * 0.5)
    if boards > 1:
        image *= _seams(rows, boards, 0.006)[..., None]
        image *= _butt_joints(rng, board, boards)[..., None]
    scale = 0.12 * boards if boards > 1 else 0.7
    return image, Finish(scale, float(rng.uniform(0.08, 0.3)), 30.0, 0.06)


def _seams(position: np.ndarray, count: int, width: float, depth: float = 0.55) -> np.ndarray:
    """Factor that darkens `count` equidistant lines; position in 0 to 1, width in the same unit."""
    distance = np.abs((position * count + 0.5) % 1.0 - 0.5) / count
    dark: np.ndarray = 1 - depth * (1 - _step(width / 2, distance, width * 0.8))
    return dark


def _butt_joints(rng: np.random.Generator, board: np.ndarray, boards: int) -> np.ndarray:
    """Where boards end: one joint per board, at a place of its own."""
    _, columns = _grid()
    return _seams((columns + rng.random(boards).astype(np.float32)[board]) % 1.0, 1, 0.006)


def _tile(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    count = int(rng.choice([2, 3, 4, 6]))
    edge_m = {2: 0.45, 3: 0.3, 4: 0.2, 6: 0.1}[count]
    rows, columns = _grid()
    base = _pick(
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
    image = _mix(base, other, odd)
    tone = rng.normal(1.0, 0.03, (count, count)).astype(np.float32)[cell_row % count, cell_column % count]
    vein = 1 - np.abs(noise(rng, 1, 20, 1.5))
    image = image * (tone * (1 + 0.02 * noise(rng, 2, 60, 0.9)))[..., None]
    image = _mix(image, image * 0.8, _step(0.9, vein, 0.25) * float(rng.uniform(0.0, 0.6)))
    joint = 0.004 / (edge_m * count)  # 4 mm
    distance = np.minimum(np.abs((rows * count + 0.5) % 1.0 - 0.5), np.abs((columns * count + 0.5) % 1.0 - 0.5)) / count
    grout = _pick(rng, ((0.45, 0.44, 0.42), (0.70, 0.69, 0.66), (0.28, 0.27, 0.27)))
    image = image * (0.9 + 0.1 * _step(2.2 * joint, distance, 2 * joint))[..., None]
    image = _mix(
        grout * (1 + 0.06 * noise(rng, 20, 128, 0.3))[..., None], image, _step(joint, distance, 0.7 * joint + 0.003)
    )
    return image, Finish(edge_m * count, float(rng.uniform(0.15, 0.5)), 70.0, 0.2)


def _brick(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    courses, bricks = 8, 3  # of 240 x 71 mm with 10 mm joints: 0.75 m wide, 0.6 m high, close to square
    rows, columns = _grid()
    course = (rows * courses).astype(np.int32)
    along = columns * bricks + (0.5 * (course % 2)).astype(np.float32)
    brick = along.astype(np.int32) % bricks
    base = _pick(
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
    mortar = _pick(rng, ((0.66, 0.64, 0.60), (0.52, 0.50, 0.47), (0.75, 0.73, 0.69)))
    mortar_image = mortar * (1 + 0.07 * noise(rng, 20, 128, 0.2))[..., None]
    image = image * (0.82 + 0.18 * _step(0.008, distance, 0.006))[..., None]
    return _mix(mortar_image, image, _step(0.005, distance, 0.004)), Finish(0.7, 0.02, 6.0, 0.02)


def _metal(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    base = _pick(rng, ((0.62, 0.63, 0.65), (0.50, 0.52, 0.54), (0.35, 0.37, 0.39), (0.68, 0.66, 0.62)))
    brushed = noise(rng, 10, 300, 0.2, stretch=30.0)
    image = base * (1 + 0.035 * brushed + 0.03 * noise(rng, 1, 6, 1.0))[..., None]
    if patterned:  # chequer plate: lens-shaped studs, alternately along both diagonals
        image = image * _chequer_plate(8)[..., None]
    rust = float(rng.uniform(0.0, 0.7)) * (rng.random() < 0.3)
    spots = _step(1.6, noise(rng, 1, 60, 1.1), 0.8)
    image = _mix(image, np.array([0.42, 0.24, 0.13], np.float32), spots * rust)
    return image, Finish(0.4, 0.55, 40.0, 0.45)


def _chequer_plate(count: int) -> np.ndarray:
    """Shading factor of count x count studs on a plate."""
    rows, columns = _grid()
    y, x = rows * count % 1.0 - 0.5, columns * count % 1.0 - 0.5
    turn = np.where(((rows * count).astype(int) + (columns * count).astype(int)) % 2 == 0, 1.0, -1.0)
    along, across = (x + turn * y) / np.sqrt(2), (x - turn * y) / np.sqrt(2)
    height = np.clip(1 - (along / 0.42) ** 2 - (across / 0.13) ** 2, 0, 1)
    lit = np.gradient(np.sqrt(height), axis=0) * -1.2
    shaded: np.ndarray = (0.92 + 0.16 * _step(0.05, height, 0.1) + np.clip(lit, -0.25, 0.35)).astype(np.float32)
    return shaded


ACCENTS: tuple[Colour, ...] = ((0.05, 0.05, 0.06), (0.10, 0.07, 0.02), (0.02, 0.05, 0.10), (0.10, 0.02, 0.02))


def _carpet(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    base = np.asarray(_hsv(rng, (0.0, 1.0, 0), (0.05, 0.42, 0), (0.25, 0.55, 0)), np.float32)
    pile = noise(rng, 40, 128, 0.1)
    loops = noise(rng, 60, 100, 0.0)
    image = base * (1 + 0.13 * pile + 0.07 * loops + 0.03 * noise(rng, 1, 10, 1.0))[..., None]
    rows, columns = _grid()
    accent = base * float(rng.uniform(0.45, 0.75) if base.max() > 0.4 else rng.uniform(1.4, 2.0)) + _pick(rng, ACCENTS)
    accent_image = accent * (1 + 0.14 * pile)[..., None]
    style = int(rng.integers(3)) if patterned else -1
    if style == 0:  # stripes
        image = _mix(image, accent_image, _step(0.75, np.cos(2 * np.pi * 4 * columns), 0.15))
    elif style == 1:  # dots
        image = _mix(
            image, accent_image, _step(0.62, np.cos(2 * np.pi * 5 * columns) * np.cos(2 * np.pi * 5 * rows), 0.15)
        )
    elif style == 2:  # flecks
        image = _mix(image, accent_image, _step(1.3, noise(rng, 20, 90, 0.2), 0.4) * 0.8)
    return image, Finish(0.5, 0.0, 4.0, 0.05)


def _painted(rng: np.random.Generator, patterned: bool) -> tuple[np.ndarray, Finish]:
    """Near white, so that a tint decides the colour."""
    roller = noise(rng, 30, 128, 0.2)
    image = np.array([0.92, 0.92, 0.91], np.float32) * (1 + 0.012 * roller + 0.012 * noise(rng, 1, 8, 1.0))[..., None]
    scuff = _step(2.1, noise(rng, 3, 128, 0.7, stretch=5.0), 0.8) * float(rng.uniform(0.0, 0.35))
    return _mix(image, image * 0.72, scuff), Finish(1.2, float(rng.uniform(0.02, 0.2)), 20.0, 0.3)


PAINTERS: dict[str, Callable[[np.random.Generator, bool], tuple[np.ndarray, Finish]]] = {
    "concrete": _concrete,
    "terrazzo": _terrazzo,
    "wood": _wood,
    "tile": _tile,
    "brick": _brick,
    "metal": _metal,
    "carpet": _carpet,
    "painted": _painted,
}
MATERIALS: tuple[str, ...] = tuple(PAINTERS)


@functools.lru_cache(maxsize=TEXTURE_CACHE)
def make_texture(material: str, seed: int) -> Texture:
    """One specimen of a material; the same arguments give the same texture.

    Args:
        material: one of MATERIALS.
        seed: which specimen, 0 or more. Odd ones are patterned where the material knows patterns: floor boards instead
            of one slab of wood, chequer plate, chequered tiles, striped carpet.

    Raises:
        SpecError: no such material.
    """
    check_choice("material", material, MATERIALS)
    rng = np.random.default_rng([MATERIALS.index(material), seed])
    image, finish = PAINTERS[material](rng, seed % 2 == 1)
    albedo = (np.clip(image, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
    albedo.setflags(write=False)
    return Texture(albedo, *finish)
