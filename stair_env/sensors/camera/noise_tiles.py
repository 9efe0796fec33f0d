"""Fixed tables of noise that the error models read at a random place in each frame.

Drawing a quarter of a million correlated normal numbers per frame costs more than the whole error model. The tables
here are constants, like the coefficients of a filter: they are made once from a fixed seed, they repeat seamlessly,
and the caller's generator decides where in them a frame begins. Two frames share a value at a pixel with probability
1 / TILE_SIDE_PX**2.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

TILE_SIDE_PX = 512
_TABLE_SEED = 435  # any constant does; changing it changes every recorded rollout


@lru_cache(maxsize=32)
def gaussian_tile(
    correlations_px: tuple[float, ...],
    shares: tuple[float, ...],
    columns: int,
    index: int,
    channels: int = 1,
    stretch: float = 1.0,
) -> np.ndarray:
    """Smooth Gaussian noise of zero mean and unit variance, seamlessly periodic.

    Args:
        correlations_px: standard deviation of the Gaussian kernel that smooths each layer, pixels; 0 is white noise.
        shares: parts of the variance that the layers carry, in any unit.
        columns: how many columns beyond one period to append, so that any window of that width is contiguous.
        index: tables with different indices are independent.
        channels: independent values per pixel, interleaved along the row as in an image.
        stretch: correlation along a row, relative to `correlations_px`, which holds across rows.

    Returns:
        (TILE_SIDE_PX, (TILE_SIDE_PX + columns) channels) float32, read-only.
    """
    generator = np.random.default_rng([_TABLE_SEED, index])
    planes = [_layered_noise(generator, correlations_px, shares, stretch) for _ in range(channels)]
    return _extended(np.stack(planes, axis=-1).reshape(TILE_SIDE_PX, -1), columns * channels)


@lru_cache(maxsize=32)
def uniform_tile(
    correlations_px: tuple[float, ...], shares: tuple[float, ...], columns: int, index: int, stretch: float = 1.0
) -> np.ndarray:
    """Smooth noise whose values are spread evenly over (0, 1): `tile < p` marks blobs that cover the share p.

    Args, shape and dtype as in `gaussian_tile`.
    """
    smooth = gaussian_tile(correlations_px, shares, 0, index, stretch=stretch)
    ranks = np.empty(smooth.size)
    ranks[np.argsort(smooth, axis=None, kind="stable")] = (np.arange(smooth.size) + 0.5) / smooth.size
    return _extended(ranks.reshape(smooth.shape), columns)


def _layered_noise(
    generator: np.random.Generator, correlations_px: tuple[float, ...], shares: tuple[float, ...], stretch: float
) -> np.ndarray:
    """(N, N) sum of smooth layers, zero mean, unit variance."""
    total = np.zeros((TILE_SIDE_PX, TILE_SIDE_PX))
    for correlation_px, share in zip(correlations_px, shares):
        layer = _smooth_periodic(generator.standard_normal((TILE_SIDE_PX, TILE_SIDE_PX)), correlation_px, stretch)
        total += np.sqrt(share) * (layer - layer.mean()) / layer.std()
    return (total - total.mean()) / total.std()


def _smooth_periodic(values: np.ndarray, correlation_px: float, stretch: float) -> np.ndarray:
    """Convolve (N, N) with a periodic Gaussian kernel, `stretch` times as long along the rows."""
    frequency = np.fft.fftfreq(len(values))
    across, along = (
        np.exp(-2.0 * (np.pi * size * frequency) ** 2) for size in (correlation_px, stretch * correlation_px)
    )
    return np.real(np.fft.ifft2(np.fft.fft2(values) * np.outer(across, along)))


def _extended(values: np.ndarray, columns: int) -> np.ndarray:
    """Repeat the first columns behind the last one, as read-only float32."""
    repeats = 1 + -(-columns // values.shape[1])
    tile = np.ascontiguousarray(np.tile(values, (1, repeats))[:, : values.shape[1] + columns], dtype=np.float32)
    tile.flags.writeable = False
    return tile
