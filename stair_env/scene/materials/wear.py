"""What use and weather do to a surface: stains, scratches, scuffs, chipped paint, dirt."""

from __future__ import annotations

import numpy as np

from stair_env.scene.materials.texture_fields import TEXTURE_SIZE_PX, mix, noise, ramp

WEAR_LEVELS = (0, 1, 2, 3)  # new, used, worn, neglected
GRIMES: tuple[tuple[float, float, float], ...] = (
    (0.30, 0.27, 0.23),
    (0.20, 0.20, 0.20),
    (0.55, 0.51, 0.45),
    (0.36, 0.27, 0.18),
)


def worn(rng: np.random.Generator, image: np.ndarray, level: int) -> np.ndarray:
    """A used specimen of a material.

    Args:
        rng: the source of all chance.
        image: (256, 256, 3) float sRGB, 0 to 1, that tiles.
        level: one of WEAR_LEVELS; 0 leaves it as it is.

    Returns:
        An image like it.
    """
    if level == 0:
        return image
    share = level / WEAR_LEVELS[-1]
    grime = np.asarray(GRIMES[int(rng.integers(len(GRIMES)))], np.float32)
    film = ramp(0.6, noise(rng, 1, 30, 1.2), 2.6) * float(rng.uniform(0.1, 0.6)) * share  # dirt in broad clouds
    image = mix(image, grime * (1 + 0.1 * noise(rng, 10, 128, 0.4))[..., None], film)
    drops = ramp(3.0 - 0.7 * share, noise(rng, 6, 60, 0.6), 0.4) * float(rng.uniform(0.2, 0.8))  # spots
    image = mix(image, image * float(rng.uniform(0.4, 0.8)), drops)
    bare = float(rng.choice([0.55, 1.35]))  # what lies below is darker or lighter
    if rng.random() < 0.3 + 0.3 * share:
        chips = ramp(2.0 - 0.7 * share, noise(rng, 2, 80, 0.8), 0.12)  # sharp borders, unlike stains
        image = mix(image, np.minimum(image * bare, 0.95), chips * 0.8)
    scuffs = ramp(2.0, noise(rng, 2, 160, 0.6, stretch=7.0), 0.5) * float(rng.uniform(0.1, 0.5)) * share
    image = mix(image, image * 0.6, scuffs)
    return _scratched(rng, image, int(rng.integers(0, 6 + 20 * level)), bare)


def _scratched(rng: np.random.Generator, image: np.ndarray, count: int, bare: float) -> np.ndarray:
    """Thin, almost straight scratches, wrapping round the borders."""
    import cv2

    mask = np.zeros((TEXTURE_SIZE_PX, TEXTURE_SIZE_PX), np.float32)
    start = rng.uniform(0, TEXTURE_SIZE_PX, (count, 2))
    length, angle = rng.uniform(4, 60, count), rng.normal(0.0, 0.9, count)
    end = start + length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    strength = rng.uniform(0.2, 0.9, count)
    wraps = TEXTURE_SIZE_PX * np.array([(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)])
    for a, b, value in zip(start, end, strength.tolist()):
        for wrap in wraps:
            first, second = (np.round((point + wrap) * 16).astype(int).tolist() for point in (a, b))
            cv2.line(mask, first, second, value, 1, cv2.LINE_AA, shift=4)
    return mix(image, np.minimum(image * bare, 0.97), mask)
