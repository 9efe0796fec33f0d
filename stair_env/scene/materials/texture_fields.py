"""Tileable fields and marks from which the textures of materials are painted.

Noise is filtered in the frequency domain and chips wrap round the borders, so that no seam shows where a texture
repeats.
"""

from __future__ import annotations

import colorsys
import functools
from typing import NamedTuple

import numpy as np
import scipy.fft

TEXTURE_SIZE_PX = 256

Colour = tuple[float, float, float]  # sRGB, 0 to 1


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


def paint_chips(
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
def grid() -> tuple[np.ndarray, np.ndarray]:
    """Row and column coordinates of the pixel centres, each (256, 256) float32 in 0 to 1."""
    axis = (np.arange(TEXTURE_SIZE_PX, dtype=np.float32) + 0.5) / TEXTURE_SIZE_PX
    rows, columns = np.meshgrid(axis, axis, indexing="ij")
    return rows, columns


def mix(a: np.ndarray | Colour, b: np.ndarray | Colour, weight: np.ndarray) -> np.ndarray:
    """Blend two colours or (256, 256, 3) images by a (256, 256) weight in 0 to 1."""
    share = np.clip(weight, 0.0, 1.0)[..., None]
    first, second = np.asarray(a, np.float32), np.asarray(b, np.float32)
    blended: np.ndarray = first + (second - first) * share
    return blended


def ramp(edge: float, value: np.ndarray, width: float) -> np.ndarray:
    """0 below edge, 1 above it, with a smooth ramp of the given width in between."""
    t = np.clip((value - edge) / width + 0.5, 0.0, 1.0)
    smooth: np.ndarray = t * t * (3.0 - 2.0 * t)
    return smooth


def hsv_colour(rng: np.random.Generator, hue: Colour, saturation: Colour, value: Colour) -> Colour:
    """A random colour; each argument is (low, high, ignored) of one channel."""
    draw = [rng.uniform(low, high) for low, high, _ in (hue, saturation, value)]
    return colorsys.hsv_to_rgb(draw[0] % 1.0, draw[1], draw[2])


def pick_colour(rng: np.random.Generator, colours: tuple[Colour, ...], jitter: float = 0.04) -> np.ndarray:
    """One of the colours, slightly off, (3,) float32."""
    colour = np.asarray(colours[int(rng.integers(len(colours)))], np.float32)
    warm = 0.4 * jitter * rng.standard_normal()
    shift = 1 + jitter * rng.standard_normal() + np.array([warm, 0.0, -warm])
    picked: np.ndarray = np.clip(colour * shift, 0.02, 0.98).astype(np.float32)
    return picked


def seams(position: np.ndarray, count: int, width: float, depth: float = 0.55) -> np.ndarray:
    """Factor that darkens `count` equidistant lines; position in 0 to 1, width in the same unit."""
    distance = np.abs((position * count + 0.5) % 1.0 - 0.5) / count
    dark: np.ndarray = 1 - depth * (1 - ramp(width / 2, distance, width * 0.8))
    return dark


def cells(rng: np.random.Generator, count: int, jitter: float) -> tuple[np.ndarray, np.ndarray]:
    """Stones around points of a jittered lattice, wrapping round.

    Args:
        rng: the source of all chance.
        count: stones along a side.
        jitter: how far points leave their places, in lattice steps.

    Returns:
        (256, 256) int64 number of the stone and float32 distance to its border in lattice steps.
    """
    from scipy.spatial import cKDTree

    row, column = np.divmod(np.arange(count * count), count)
    points = np.stack([row + 0.5, column + 0.25 + 0.5 * (row % 2)], axis=1) + rng.uniform(
        -jitter, jitter, (len(row), 2)
    )
    rows, columns = grid()
    where = np.stack([rows.ravel(), columns.ravel()], axis=1) * count
    distance, index = cKDTree(points % count, boxsize=count).query(where, k=2)
    number = index[:, 0].reshape(TEXTURE_SIZE_PX, TEXTURE_SIZE_PX)
    border = (distance[:, 1] - distance[:, 0]).reshape(number.shape).astype(np.float32)
    return number, border
