"""Lines in, grid, lines out: what is known must come back."""

from __future__ import annotations

import numpy as np
import pytest

from perception.data.label_grid import encode_grid
from perception.geometry.lines import (
    LINE_FIELDS,
    SAME_LINE_PX,
    Segments,
    as_stair_lines,
    cluster_segments,
    decode_cells,
    find_lines,
    median,
    to_image_pixels,
)
from stair_env.common.constants import GRID_COLUMNS, GRID_ROWS

K, B, SCORE, SUPPORT = (LINE_FIELDS.index(name) for name in ("k", "b", "score", "support"))


def recover(lines: np.ndarray, jitter_px: float = 0.0, seed: int = 0) -> np.ndarray:
    grid = encode_grid(lines)
    noise = np.random.default_rng(seed).normal(0.0, jitter_px / 16.0, (*grid.loc.shape[:2], 2))
    loc = grid.loc.copy()
    loc[..., 1::2] += np.concatenate([noise, noise], axis=-1)
    return find_lines(grid.cls, loc)


def height_at(rows: np.ndarray, x: float) -> np.ndarray:
    return rows[:, K] * x + rows[:, B]


def random_staircase(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 4) lines through one vanishing point, at least 9 px apart, as the edges of one staircase are."""
    spacing = rng.uniform(9.0, 40.0, count)
    y = 40.0 + np.cumsum(spacing) * min(1.0, 400.0 / spacing.sum())
    vanishing_x = rng.choice([-1.0, 1.0]) * rng.uniform(1500.0, 6000.0)
    slope = (y - rng.uniform(0, 300.0)) / (256.0 - vanishing_x)
    x1, x2 = rng.uniform(0.0, 150.0, count), rng.uniform(360.0, 512.0, count)
    return np.stack([x1, y + slope * (x1 - 256.0), x2, y + slope * (x2 - 256.0)], axis=1)


@pytest.mark.parametrize("seed", range(30))
def test_a_staircase_comes_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lines = random_staircase(rng, int(rng.integers(1, 13)))
    found = recover(lines)
    assert len(found) == len(lines)
    middle = lines[:, 1] + (lines[:, 3] - lines[:, 1]) * (256.0 - lines[:, 0]) / (lines[:, 2] - lines[:, 0])
    assert np.abs(np.sort(height_at(found, 256.0)) - np.sort(middle)).max() < 0.1
    assert np.allclose(found[:, 1], found[:, K] * found[:, 0] + found[:, B])
    assert np.allclose(found[:, 3], found[:, K] * found[:, 2] + found[:, B])


@pytest.mark.parametrize("seed", range(20))
def test_jitter_averages_out(seed: int) -> None:
    lines = random_staircase(np.random.default_rng(seed), 7)
    found = recover(lines, jitter_px=0.8, seed=seed)
    assert len(found) == len(lines)
    middle = lines[:, 1] + (lines[:, 3] - lines[:, 1]) * (256.0 - lines[:, 0]) / (lines[:, 2] - lines[:, 0])
    error = np.sort(height_at(found, 256.0)) - np.sort(middle)
    assert np.abs(error).max() < 1.2
    assert np.sqrt(np.mean(error**2)) < 0.6


def test_ends_are_those_of_the_line() -> None:
    found = recover(np.array([[70.0, 200.0, 430.0, 230.0]]))
    assert found[0, :4] == pytest.approx([70.0, 200.0, 430.0, 230.0], abs=1.0)
    assert found[0, SCORE] == 1.0


def test_crossing_lines_stay_apart() -> None:
    lines = np.array([[0.0, 150.0, 512.0, 250.0], [0.0, 250.0, 512.0, 150.0]])
    found = recover(lines)
    slopes = found[np.argsort(-found[:, SUPPORT])][:2, K]
    assert sorted(slopes) == pytest.approx([-100 / 512, 100 / 512], abs=0.02)


def test_a_gap_does_not_split_a_line() -> None:
    halves = np.array([[0.0, 300.0, 170.0, 296.0], [340.0, 292.0, 512.0, 288.0]])
    found = recover(halves)
    assert len(found) == 1
    assert found[0, 0] == pytest.approx(0.0, abs=1.0)
    assert found[0, 2] == pytest.approx(512.0, abs=1.0)


def test_one_short_line() -> None:
    found = recover(np.array([[300.0, 200.0, 350.0, 204.0]]))
    assert len(found) == 1
    assert height_at(found, 325.0)[0] == pytest.approx(202.0, abs=0.3)


def test_lines_in_one_column_only() -> None:
    lines = np.array([[97.0, y, 127.0, y + 1.0] for y in (100.0, 150.0, 200.0)])
    found = recover(lines)
    assert height_at(found, 112.0) == pytest.approx([100.5, 150.5, 200.5], abs=0.3)


def test_nothing_gives_nothing() -> None:
    assert find_lines(np.zeros((32, 16)), np.zeros((32, 16, 8))).shape == (0, len(LINE_FIELDS))


def test_two_near_equal_predictions_count_once() -> None:
    cls, loc = np.zeros((32, 16)), np.zeros((32, 16, 8))
    cls[10, 8] = 0.9
    loc[10, 8] = [0.0, 0.5, 1.0, 0.5, 0.0, 0.5 + 0.8 * SAME_LINE_PX / 16.0, 1.0, 0.5 + 0.8 * SAME_LINE_PX / 16.0]
    assert len(decode_cells(cls, loc)) == 1
    loc[10, 8, 5::2] = 0.5 + 2.0 * SAME_LINE_PX / 16.0
    assert len(decode_cells(cls, loc)) == 2


def test_threshold_is_inclusive() -> None:
    cls, loc = np.zeros((32, 16)), np.full((32, 16, 8), 0.5)
    cls[3, 3] = 0.5
    assert len(decode_cells(cls, loc)) == 1
    assert len(decode_cells(cls, loc, threshold=0.51)) == 0


def test_left_end_comes_first() -> None:
    cls, loc = np.zeros((32, 16)), np.zeros((32, 16, 8))
    cls[4, 4] = 1.0
    loc[4, 4] = [0.9, 0.2, 0.1, 0.6] * 2
    ends = decode_cells(cls, loc).ends[0]
    assert ends[0] < ends[2]
    assert ends[1] > ends[3]


def test_letterbox_is_undone() -> None:
    """A line of a 640 x 480 image, letterboxed and found, is where it was."""
    scale, top = 512 / 640, 80
    original = np.array([[50.0, 120.0, 600.0, 150.0]])
    boxed = (original + np.array([0, top, 0, top])) * scale
    found = to_image_pixels(recover(boxed), 640, 480)
    assert height_at(found, 320.0)[0] == pytest.approx(120.0 + 30.0 * 270 / 550, abs=0.3)
    assert found[0, 0] == pytest.approx(50.0, abs=1.5)


def test_lines_in_the_padding_are_left_out() -> None:
    boxed = recover(np.array([[50.0, 20.0, 450.0, 20.0]]))
    assert len(boxed) == 1
    assert len(to_image_pixels(boxed, 640, 480)) == 0


def test_order_of_segments_does_not_matter() -> None:
    grid = encode_grid(random_staircase(np.random.default_rng(4), 6))
    segments = decode_cells(grid.cls, grid.loc)
    order = np.random.default_rng(0).permutation(len(segments))
    shuffled = Segments(segments.ends[order], segments.column[order], segments.score[order])
    assert np.allclose(cluster_segments(segments), cluster_segments(shuffled))


def assert_sane(found: np.ndarray) -> None:
    assert found.ndim == 2 and found.shape[1] == len(LINE_FIELDS)
    assert np.isfinite(found).all()
    assert (found[:, 0] <= found[:, 2]).all()
    assert (found[:, SUPPORT] >= 1).all()
    assert ((found[:, SCORE] >= 0.5) & (found[:, SCORE] <= 1.0)).all()


@pytest.mark.parametrize("seed", range(10))
def test_random_tensors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for density in (0.51, 0.6, 1.0):
        cls = rng.random((GRID_ROWS, GRID_COLUMNS)) * density
        assert_sane(find_lines(cls, rng.random((GRID_ROWS, GRID_COLUMNS, 8))))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_none(bad: float) -> None:
    rng = np.random.default_rng(0)
    cls, loc = rng.random((32, 16)), rng.random((32, 16, 8))
    cls[rng.random(cls.shape) < 0.2] = bad if bad < 0 or np.isnan(bad) else 0.7
    loc[rng.random(loc.shape) < 0.2] = bad
    assert_sane(find_lines(cls, loc))


@pytest.mark.parametrize(("cls_shape", "loc_shape"), [((16, 32), (32, 16, 8)), ((32, 16), (32, 16, 4))])
def test_wrong_shapes_are_named(cls_shape: tuple[int, ...], loc_shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="shape"):
        find_lines(np.zeros(cls_shape), np.zeros(loc_shape))


def test_rows_become_objects() -> None:
    rows = recover(np.array([[0.0, 100.0, 512.0, 110.0], [0.0, 200.0, 512.0, 210.0]]))
    lines = as_stair_lines(rows, ("convex", "concave"))
    assert [line.kind for line in lines] == ["convex", "concave"]
    assert lines[0].k == pytest.approx(10 / 512, abs=1e-3)
    assert isinstance(lines[0].support, int)


@pytest.mark.parametrize("count", [1, 2, 7, 40])
def test_median_is_numpys(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    assert median(values) == pytest.approx(np.median(values), rel=1e-15)
