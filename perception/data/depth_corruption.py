"""Ways in which depth lies, for training: what a detector must see through, or be able to do without.

A network that is trained on one sensor's depth learns that sensor. Each function here changes a depth image in one way
that some camera, some light or some mishap brings about, and `corrupt_depth` strings a few of them together.
All take and give float32 (H, W) metres, 0 = no reading, and none changes its argument.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

NEAREST_M = 0.15
INVERSE_DEPTH_OF_PIXEL = 1.0 / (447.0 * 0.05)  # 1/m that one pixel of disparity stands for, D435i at 848x480

Corruption = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _inverse(depth_m: np.ndarray) -> np.ndarray:
    return np.where(depth_m > 0.0, 1.0 / np.maximum(depth_m, NEAREST_M), 0.0).astype(np.float32)


def _from_inverse(inverse: np.ndarray, valid: np.ndarray) -> np.ndarray:
    return np.where(valid, 1.0 / np.maximum(inverse, 0.02), 0.0).astype(np.float32)


def _smooth_field(shape: tuple[int, ...], rng: np.random.Generator, scale_px: float) -> np.ndarray:
    """(H, W) float32 noise of unit variance that varies over scale_px pixels."""
    coarse_shape = tuple(max(int(np.ceil(side / scale_px)) + 3, 4) for side in shape)
    coarse = rng.standard_normal(coarse_shape, dtype=np.float32)
    field = cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
    return field / np.float32(max(float(field.std()), 1e-6))


def blurred(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Creases rounded: inverse depth averaged over a window, along columns more or less than along rows."""
    valid = depth_m > 0.0
    sigma = _log_uniform(rng, 1.0, 18.0)
    across = sigma * _log_uniform(rng, 0.5, 1.5)
    weight = cv2.GaussianBlur(valid.astype(np.float32), (0, 0), across, sigmaY=sigma)
    mean: np.ndarray = cv2.GaussianBlur(_inverse(depth_m), (0, 0), across, sigmaY=sigma) / np.maximum(weight, 1e-6)
    return _from_inverse(mean, valid)


def box_averaged(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Medians over a window, which fatten edges: what a matcher's large block or a user's filter does."""
    side = int(rng.choice([5, 7, 9, 13]))
    scale = 2 if side > 5 else 1
    small = depth_m[::scale, ::scale]
    inverse = np.minimum(_inverse(small) * 50.0, 255.0).astype(np.uint8) if scale == 2 and side > 9 else None
    if inverse is not None:  # OpenCV takes 8 bits for large windows; coarse steps are part of the corruption
        small_median = np.asarray(cv2.medianBlur(inverse, side), np.float32) / 50.0
    else:
        small_median = np.asarray(cv2.medianBlur(_inverse(small), 5))
    median: np.ndarray = cv2.resize(small_median, depth_m.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return _from_inverse(median, (depth_m > 0.0) & (median > 0.02))


def single_holes(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Single readings missing."""
    share = _log_uniform(rng, 0.004, 0.45)
    return np.where(rng.random(depth_m.shape, dtype=np.float32) < share, np.float32(0.0), depth_m)


def blobs_missing(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Patches without reading."""
    field = _smooth_field(depth_m.shape, rng, _log_uniform(rng, 6.0, 80.0))
    return np.where(field > np.quantile(field[::4, ::4], 1.0 - rng.uniform(0.03, 0.6)), np.float32(0.0), depth_m)


def creases_missing(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Bands along edges and creases lost, some of them for the whole length of a tread."""
    inverse = _inverse(depth_m)
    reach = int(rng.integers(2, 6))
    bend = np.abs(
        np.roll(inverse, reach, 0) + np.roll(inverse, -reach, 0) - 2.0 * inverse
    ) / INVERSE_DEPTH_OF_PIXEL  # fmt: skip
    lost = (bend > _log_uniform(rng, 0.05, 0.6)) & (_smooth_field(depth_m.shape, rng, 90.0) > rng.uniform(-1.5, 1.0))
    kernel = np.ones((int(rng.integers(1, 10)), int(rng.integers(1, 20))), np.uint8)
    return np.where(cv2.dilate(lost.astype(np.uint8), kernel) > 0, np.float32(0.0), depth_m)


def rows_missing(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Horizontal streaks lost, as where repeated edges cannot be told apart."""
    rows, columns = depth_m.shape
    scale = _log_uniform(rng, 1.5, 12.0)
    coarse = rng.standard_normal((max(int(rows / scale), 4), max(int(columns / (scale * 15.0)), 3)), dtype=np.float32)
    field = cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_LINEAR)
    return np.where(field > rng.uniform(0.6, 1.8), np.float32(0.0), depth_m)


def false_patches(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Patches at a wrong distance: repeated structures matched one period off."""
    field = _smooth_field(depth_m.shape, rng, _log_uniform(rng, 5.0, 60.0))
    where = (field > np.quantile(field[::4, ::4], 1.0 - rng.uniform(0.01, 0.2))) & (depth_m > 0.0)
    return np.where(where, np.maximum(depth_m * np.float32(_log_uniform(rng, 0.4, 1.8)), np.float32(0.2)), depth_m)


def sparks(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Single readings or small clusters with values from anywhere."""
    lost: np.ndarray = (rng.random(depth_m.shape, dtype=np.float32) < _log_uniform(rng, 0.001, 0.04)).astype(np.uint8)
    size = int(rng.integers(1, 4))
    lost = cv2.dilate(lost, np.ones((size, size), np.uint8)) if size > 1 else lost
    return np.where(lost > 0, rng.uniform(0.2, 6.0, depth_m.shape).astype(np.float32), depth_m)


def waves(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Slowly varying disparity error."""
    error = _smooth_field(depth_m.shape, rng, _log_uniform(rng, 10.0, 120.0)) * _log_uniform(rng, 0.05, 0.8)
    return _from_inverse(_inverse(depth_m) + error * np.float32(INVERSE_DEPTH_OF_PIXEL), depth_m > 0.0)


def noisy(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Disparity noise, of single pixels up to a matcher's window wide."""
    error: np.ndarray = rng.standard_normal(depth_m.shape, dtype=np.float32)
    sigma = rng.uniform(0.0, 3.0)
    if sigma > 0.4:
        smooth = np.asarray(cv2.GaussianBlur(error, (0, 0), sigma))
        error = smooth / np.float32(max(float(smooth.std()), 1e-6))
    error *= np.float32(_log_uniform(rng, 0.03, 0.6) * INVERSE_DEPTH_OF_PIXEL)
    return _from_inverse(_inverse(depth_m) + error, depth_m > 0.0)


def coarse_steps(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Disparity or depth in coarse steps: 8-bit images, matchers without sub-pixels."""
    if rng.random() < 0.5:
        step = np.float32(_log_uniform(rng, 0.125, 1.0) * INVERSE_DEPTH_OF_PIXEL)
        return _from_inverse(np.maximum(np.round(_inverse(depth_m) / step), 1.0) * step, depth_m > 0.0)
    step = np.float32(_log_uniform(rng, 0.005, 0.04))
    return (np.round(depth_m / step) * step).astype(np.float32)


def coarse_pixels(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A smaller depth image enlarged, by repetition or linearly."""
    factor = int(rng.integers(2, 9))
    small = depth_m[factor // 2 :: factor, factor // 2 :: factor]
    size = depth_m.shape[::-1]
    if rng.random() < 0.5:
        return cv2.resize(small, size, interpolation=cv2.INTER_NEAREST)
    inverse = cv2.resize(_inverse(small), size, interpolation=cv2.INTER_LINEAR)
    valid = cv2.resize((small > 0.0).astype(np.float32), size, interpolation=cv2.INTER_LINEAR) > 0.9
    return _from_inverse(inverse, valid)


def displaced(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Not aligned with colour: shifted, turned and scaled a little."""
    height, width = depth_m.shape
    matrix: np.ndarray = cv2.getRotationMatrix2D(
        (width / 2, height / 2), rng.normal(0.0, 0.7), _log_uniform(rng, 0.96, 1.04)
    )
    matrix[:, 2] += rng.normal(0.0, 6.0, 2)
    return cv2.warpAffine(depth_m, matrix, (width, height), flags=cv2.INTER_NEAREST)


def rescaled(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A wrong unit, focal length or baseline."""
    return depth_m * np.float32(_log_uniform(rng, 0.75, 1.35))


def left_band_missing(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The side that the second imager does not see, or a smaller field of view than colour's."""
    out = depth_m.copy()
    margins = rng.uniform(0.0, 0.22, 4) * (rng.random(4) < 0.5)
    top, bottom, left, right = (margins * np.array([*depth_m.shape[:1] * 2, *depth_m.shape[1:] * 2])).astype(int)
    out[:top] = 0.0
    out[depth_m.shape[0] - bottom :] = 0.0
    out[:, :left] = 0.0
    out[:, depth_m.shape[1] - right :] = 0.0
    return out


CORRUPTIONS: dict[str, tuple[Corruption, float]] = {  # with the share of each among those drawn
    "blurred": (blurred, 3.5),
    "box averaged": (box_averaged, 1.0),
    "single holes": (single_holes, 2.0),
    "blobs missing": (blobs_missing, 1.5),
    "creases missing": (creases_missing, 1.5),
    "rows missing": (rows_missing, 1.5),
    "false patches": (false_patches, 1.5),
    "sparks": (sparks, 1.5),
    "waves": (waves, 1.0),
    "noisy": (noisy, 1.5),
    "coarse steps": (coarse_steps, 0.7),
    "coarse pixels": (coarse_pixels, 0.7),
    "displaced": (displaced, 1.0),
    "rescaled": (rescaled, 0.7),
    "left band missing": (left_band_missing, 0.7),
}


def corrupt_depth(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Apply one to four corruptions, drawn by their shares, in random order.

    Args:
        depth_m: float32 (H, W), metres, 0 = no reading.
        rng: the source of all chance.

    Returns:
        float32 (H, W), a new array.
    """
    names = list(CORRUPTIONS)
    shares = np.array([CORRUPTIONS[name][1] for name in names])
    count = int(rng.choice([1, 2, 3, 4], p=[0.4, 0.3, 0.2, 0.1]))
    for index in rng.choice(len(names), count, replace=False, p=shares / shares.sum()):
        depth_m = CORRUPTIONS[names[int(index)]][0](depth_m, rng).astype(np.float32)
    return depth_m


def meaningless_depth(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Depth that says nothing about the scene: constant, a ramp, or slow waves around a constant; float32 (H, W)."""
    inverse: np.ndarray = np.full(shape, 1.0 / _log_uniform(rng, 0.4, 8.0), np.float32)
    draw = rng.random()
    if draw < 0.4:
        return 1.0 / inverse
    v, u = np.linspace(-1.0, 1.0, shape[0]), np.linspace(-1.0, 1.0, shape[1])
    inverse = inverse * (1.0 + rng.uniform(-0.8, 0.8) * v[:, None] + rng.uniform(-0.3, 0.3) * u[None])
    if draw < 0.7:
        inverse = inverse + 0.1 * _smooth_field(shape, rng, _log_uniform(rng, 20.0, 150.0))
    return (1.0 / np.clip(inverse, 0.1, 6.0)).astype(np.float32)
