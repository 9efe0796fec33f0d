import numpy as np
import pytest

from stair_env.sensors.camera.stereo import StereoConfig, kernels
from stair_env.sensors.camera.stereo.filters import PERSISTENCY, TemporalFilter, decimate, post_process


def image(seed=0, shape=(24, 36), missing=0.3):
    rng = np.random.default_rng(seed)
    values = rng.uniform(5.0, 20.0, shape).astype(np.float32)
    return np.where(rng.random(shape) < missing, 0.0, values).astype(np.float32)


@pytest.mark.parametrize(("factor", "of_them"), [(2, np.median), (3, np.median), (4, np.mean), (5, np.mean)])
def test_decimation_takes_the_middle_of_the_readings_that_exist(factor, of_them):
    given = image()
    out = decimate(given, factor)
    assert out.shape == (24 // factor, 36 // factor) and out.dtype == np.float32
    for v, u in np.ndindex(out.shape):
        cell = given[v * factor : (v + 1) * factor, u * factor : (u + 1) * factor]
        readings = np.sort(cell[cell > 0.0])
        if len(readings) == 0:
            assert out[v, u] == 0.0
        elif of_them is np.mean:
            assert out[v, u] == pytest.approx(readings.mean(), rel=1e-5)
        else:
            assert out[v, u] == readings[(len(readings) - 1) // 2]


def test_decimation_by_one_changes_nothing():
    given = image()
    assert decimate(given, 1) is given


def test_the_spatial_filter_calms_surfaces_and_keeps_edges_and_holes():
    rng = np.random.default_rng(0)
    clean = np.where(np.arange(60) < 30, 10.0, 14.0) * np.ones((40, 1))
    noisy = (clean + rng.normal(0.0, 0.1, clean.shape)).astype(np.float32)
    noisy[5:8, 10:14] = 0.0
    before = noisy.copy()
    out = post_process(noisy, StereoConfig(spatial_alpha=0.5, spatial_delta_px=0.625))
    np.testing.assert_array_equal(noisy, before)
    seen = out > 0.0
    np.testing.assert_array_equal(seen, noisy > 0.0)
    assert (out - clean)[seen].std() < 0.6 * (noisy - clean)[seen].std()
    assert np.abs(out - clean)[seen].max() < 0.5, "nothing leaks over the edge"


def test_the_spatial_filter_keeps_planes():
    plane = np.full((20, 30), 12.5, np.float32)
    out = post_process(plane, StereoConfig(spatial_alpha=0.4))
    np.testing.assert_allclose(out, plane, rtol=1e-6)


def test_the_temporal_filter_averages_follows_jumps_and_keeps_holes():
    filtered = TemporalFilter(alpha=0.4, delta_px=0.6)
    first = np.array([[10.0, 10.0, 10.0, 0.0]], np.float32)
    np.testing.assert_array_equal(filtered.apply(first), first)
    out = filtered.apply(np.array([[10.5, 14.0, 0.0, 9.0]], np.float32))
    np.testing.assert_allclose(out, [[10.2, 14.0, 0.0, 9.0]], rtol=1e-6)


@pytest.mark.parametrize("persistency", range(9))
def test_persistency_replaces_what_is_missing_when_the_last_frames_had_it(persistency):
    rng = np.random.default_rng(persistency)
    filtered, seen = TemporalFilter(1.0, 0.6, persistency), rng.random((20, 50)) < 0.6
    needed, frames = PERSISTENCY[persistency]
    last = 0.0
    for index in range(20):
        out = filtered.apply(np.where(seen[index], np.float32(7.0 + index), 0.0).astype(np.float32)[None])[0]
        missing = ~seen[index]
        if index >= 8:
            recent = seen[index - frames : index].sum(axis=0)
            np.testing.assert_array_equal(out[missing], np.where(recent >= needed, last, 0.0)[missing])
        last = np.where(seen[index], 7.0 + index, last)


@pytest.mark.parametrize(("mode", "expected"), [(0, 6.0), (1, 4.0), (2, 9.0)])
def test_hole_filling_takes_the_left_the_farthest_or_the_nearest(mode, expected):
    given = np.array([[4.0, 9.0, 5.0], [6.0, 0.0, 5.0], [7.0, 8.0, 5.0]], np.float32)
    kernels.fill_holes(given, mode)
    assert given[1, 1] == expected


def test_hole_filling_leaves_readings_and_the_left_band():
    given = image(missing=0.4)
    given[:, :5] = 0.0
    for name in ("left", "far", "near"):
        out = post_process(given, StereoConfig(hole_filling=name))
        np.testing.assert_array_equal(out[given > 0.0], given[given > 0.0])
        assert (out[:, 8:] > 0.0).mean() > 0.95 and not out[:, :5].any(), "filled from the left, where nothing is"


def test_alignment_of_a_wall_is_exact_and_moves_it_by_the_parallax():
    camera = np.array([400.0, 400.0, 100.0, 60.0])
    depth = np.zeros((120, 200), np.float32)
    depth[40:80, 50:150] = 2.0
    out = np.empty_like(depth)
    kernels.align(depth, camera, 0.05, camera, out)
    expected = np.zeros_like(depth)
    expected[40:81, 60:161] = 2.0  # 400 px * 0.05 m / 2 m to the right; a pixel that ends on a border touches the next
    np.testing.assert_array_equal(out, expected)
    near = depth.copy()
    near[50:60, 60:70] = 1.0
    kernels.align(near, camera, 0.05, camera, out)
    assert (out[50:60, 80:90] == 1.0).all(), "what is nearer hides what is farther"
