import numpy as np
import pytest

from stair_env.sensors.camera.depth_model import depth_kernels, scene_kernels
from stair_env.sensors.camera.depth_model.scene_kernels import CELL_PX, see_rows

FOCAL_BASELINE = np.float32(20.0)
FAR = (np.float32(0.0), np.float32(1e9))


def see(depth_m, rgb=None, range_m=FAR, places=None, shifts=(0.0, 0.0), order=1):
    """exact_m, disparity, measured, statistics."""
    height, width = depth_m.shape
    rgb = np.zeros((height, width, 3), np.uint8) if rgb is None else rgb
    rows, starts, sources = places or (np.arange(height), np.array([0, width]), np.array([0]))
    cells, columns = -(-height // CELL_PX), -(-width // CELL_PX)
    out = [np.full((height, width), np.nan, np.float32) for _ in range(3)]
    statistics = np.full((4, cells, columns), np.nan, np.float32)
    see_rows(
        np.arange(cells)[::order], depth_m, rgb, range_m, FOCAL_BASELINE, rows, starts, sources,
        (np.float32(shifts[0]), np.float32(shifts[1])), *out, statistics,
    )  # fmt: skip
    return *out, statistics


def test_both_files_mean_the_same_cells():
    assert scene_kernels.CELL_PX == depth_kernels.CELL_PX


def test_depth_is_laid_over_in_stretches():
    depth = np.arange(1, 25, dtype=np.float32).reshape(4, 6)
    exact, disparity, measured, _ = see(depth, places=(np.array([1, 1, 2, 3]), np.array([0, 2, 6]), np.array([1, 2])))
    np.testing.assert_array_equal(exact, depth[[1, 1, 2, 3]][:, [1, 2, 2, 3, 4, 5]])
    np.testing.assert_array_equal(disparity, FOCAL_BASELINE / exact)
    np.testing.assert_array_equal(measured, disparity)


def test_what_is_out_of_range_or_no_number_is_not_there():
    depth = np.array([[0.05, 0.1, 1.0, 20.0, 21.0, np.nan, np.inf, -1.0, 0.0]], np.float32)
    exact, disparity, _, _ = see(depth, range_m=(np.float32(0.1), np.float32(20.0)))
    assert (exact[0] > 0).tolist() == [False, True, True, True] + [False] * 5
    assert ((disparity > 0) == (exact > 0)).all()


def test_shadows_are_as_wide_as_disparities_differ():
    depth = np.full((8, 200), 2.0, np.float32)
    depth[:, 100:] = 0.5
    for shifts in ((1.0, 0.0), (0.0, 1.0), (1.0, 0.3)):
        _, disparity, measured, _ = see(depth, shifts=shifts)
        assert (measured[3] == 0.0).sum() == 20.0 / 0.5 - 20.0 / 2.0
        assert (measured[3, 70:100] == 0.0).all() and (disparity > 0.0).all()


@pytest.mark.parametrize("size", [(16, 24), (19, 21), (3, 5), (8, 34)])
def test_cells_average_every_second_pixel(size):
    rng = np.random.default_rng(0)
    height, width = size
    rgb = rng.integers(0, 256, (height, width, 3)).astype(np.uint8)
    depth = rng.uniform(0.5, 3.0, size).astype(np.float32) * (rng.random(size) < 0.7)
    _, disparity, _, statistics = see(depth, rgb)
    green = rgb[..., 1].astype(int)
    ahead = green[:, np.minimum(np.arange(width) + 2, width - 1)]
    for i in range(statistics.shape[1]):
        for j in range(statistics.shape[2]):
            cut = np.s_[i * CELL_PX : (i + 1) * CELL_PX : 2, j * CELL_PX : (j + 1) * CELL_PX : 2]
            there = disparity[cut][disparity[cut] > 0]
            expected = [
                green[cut].mean(), np.abs(green - ahead)[cut].mean(), (green[cut] >= 250).mean(),
                there.mean() if len(there) else 0.0,
            ]  # fmt: skip
            np.testing.assert_allclose(statistics[:, i, j], expected, rtol=1e-5, atol=1e-6)


def test_the_order_of_the_rows_changes_nothing():
    rng = np.random.default_rng(2)
    depth = rng.uniform(0.5, 3.0, (40, 50)).astype(np.float32)
    rgb = rng.integers(0, 256, (40, 50, 3)).astype(np.uint8)
    for one, other in zip(see(depth, rgb, shifts=(1.0, 0.3)), see(depth, rgb, shifts=(1.0, 0.3), order=-1)):
        np.testing.assert_array_equal(one, other)
