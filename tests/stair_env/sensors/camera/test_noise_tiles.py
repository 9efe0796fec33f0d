import numpy as np
import pytest

from stair_env.sensors.camera.noise_tiles import TILE_SIDE_PX, gaussian_tile, uniform_tile

N = TILE_SIDE_PX


@pytest.mark.parametrize("correlations_px", [(0.0,), (2.0,), (1.5, 8.0)])
def test_gaussian_noise_has_no_mean_unit_variance_and_normal_tails(correlations_px):
    tile = gaussian_tile(correlations_px, (1.0, 0.5)[: len(correlations_px)], 0, 7)
    assert tile.shape == (N, N) and tile.dtype == np.float32
    assert tile.mean() == pytest.approx(0.0, abs=1e-5) and tile.std() == pytest.approx(1.0, abs=1e-5)
    assert np.mean(np.abs(tile) > 1.96) == pytest.approx(0.05, abs=0.015)


def test_uniform_noise_is_below_p_on_the_share_p():
    tile = uniform_tile((3.0, 6.0), (0.5, 0.5), 0, 8)
    assert tile.min() > 0.0 and tile.max() < 1.0
    for share in (0.001, 0.05, 0.5, 0.97):
        assert np.mean(tile < share) == pytest.approx(share, abs=1e-4)


@pytest.mark.parametrize("make", [gaussian_tile, uniform_tile])
@pytest.mark.parametrize("columns", [0, 1, 640, 1280])
def test_tables_repeat_without_a_seam(make, columns):
    tile = make((2.0,), (1.0,), columns, 9)
    assert tile.shape == (N, N + columns)
    np.testing.assert_array_equal(tile[:, N:], np.tile(tile[:, :N], (1, 3))[:, :columns])
    step_inside, step_at_seam = np.abs(np.diff(tile[:, :N])).mean(), np.abs(tile[:, N - 1] - tile[:, 0]).mean()
    assert step_at_seam == pytest.approx(step_inside, rel=0.25)


@pytest.mark.parametrize("correlation_px", [1.0, 3.0])
def test_noise_is_as_smooth_as_asked(correlation_px):
    tile = gaussian_tile((correlation_px,), (1.0,), 0, 10)
    lag = round(2 * correlation_px)
    expected = np.exp(-((lag / (2 * correlation_px)) ** 2))  # white noise through a Gaussian kernel
    assert np.mean(tile[:, lag:] * tile[:, :-lag]) == pytest.approx(expected, abs=0.05)
    assert np.mean(tile[lag:] * tile[:-lag]) == pytest.approx(expected, abs=0.05)


def test_channels_and_indices_are_independent():
    coloured = gaussian_tile((0.8,), (1.0,), 5, 11, channels=3).reshape(N, N + 5, 3)
    other = gaussian_tile((0.8,), (1.0,), 5, 12)
    planes = [coloured[:, :N, channel].ravel() for channel in range(3)] + [other[:, :N].ravel()]
    correlations = np.corrcoef(planes)
    assert np.abs(correlations - np.eye(4)).max() < 0.02
    np.testing.assert_array_equal(coloured[:, N:], coloured[:, :5])


def test_tables_cannot_be_written():
    with pytest.raises(ValueError, match="read-only"):
        gaussian_tile((2.0,), (1.0,), 0, 7)[0, 0] = 1.0
