"""The borders that are drawn again are those that show."""

import numpy as np
import pytest

from stair_env.sensors.camera.renderers import smoothing


def borders_one_by_one(regions, rgb):
    """Pixels v * W + u that differ in region, and visibly in colour, from one of their four neighbours."""
    height, width = regions.shape
    found = set()
    for v, u in np.ndindex(height, width):
        for other_v, other_u in ((v, u - 1), (v, u + 1), (v - 1, u), (v + 1, u)):
            inside = 0 <= other_v < height and 0 <= other_u < width
            if inside and regions[v, u] != regions[other_v, other_u]:
                contrast = np.abs(rgb[v, u].astype(int) - rgb[other_v, other_u]).sum()
                if contrast >= 16:
                    found.add(v * width + u)
    return found


@pytest.mark.parametrize(("height", "width"), [(32, 48), (37, 41), (16, 5), (1, 1)])
def test_borders_are_those_found_one_by_one(height, width):
    rng = np.random.default_rng(height)
    coarse = rng.integers(-1, 3, (-(-height // 7), -(-width // 9)))
    regions = np.ascontiguousarray(np.kron(coarse, np.ones((7, 9)))[:height, :width], np.int32)
    rgb = (40 * regions[..., None] + rng.integers(0, 8, (height, width, 3)) + 50).astype(np.uint8)
    rgb[regions == 1] = rgb[regions == 2].mean(axis=0) if (regions == 2).any() else 0
    tiles = -(-height // smoothing.TILE)
    pixels, counts = np.empty((tiles, smoothing.TILE * width), np.int64), np.zeros(tiles, np.int64)
    smoothing.find_borders(np.arange(tiles), regions, rgb, pixels, counts)
    found = np.concatenate([row[:count] for row, count in zip(pixels, counts)])
    assert len(set(found.tolist())) == len(found)
    assert set(found.tolist()) == borders_one_by_one(regions, rgb)
