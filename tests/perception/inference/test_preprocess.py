import cv2
import numpy as np
import pytest

from perception.inference.preprocess import close_small_holes, colour_input, depth_input, letterbox, letterbox_lines


@pytest.mark.parametrize(("width", "height"), [(640, 480), (848, 480), (480, 640), (300, 200), (512, 384), (512, 512)])
def test_labels_stay_on_what_they_mark(width, height):
    rgb, depth = np.full((height, width, 3), 90, np.uint8), np.full((height, width), 1.0, np.float32)
    row, left, right = height // 3, width // 4, width // 2
    rgb[row : row + 5, left:right] = 255
    depth[row:] = 2.0
    boxed, boxed_depth = letterbox(rgb, depth)
    x1, y1, x2, _ = letterbox_lines(np.array([[left, row + 2.5, right, row + 2.5]]), width, height)[0]
    weights = boxed[..., 0].astype(float) - 90
    weights[weights < 0] = 0
    rows, columns = np.indices(weights.shape) + 0.5
    assert (weights * rows).sum() / weights.sum() == pytest.approx(y1, abs=0.02)
    assert (weights * columns).sum() / weights.sum() == pytest.approx((x1 + x2) / 2, abs=0.02)
    edge = letterbox_lines(np.array([[0, row, width, row]]), width, height)[0, 1]
    middle = boxed_depth[:, 256]
    assert abs(np.argmax(middle == 2.0) - edge) <= 0.51  # depth steps where its row does
    assert set(np.unique(boxed_depth)) <= {0.0, 1.0, 2.0}  # never averaged


def test_padding_is_zero_and_centred():
    boxed, depth = letterbox(np.full((480, 640, 3), 9, np.uint8), np.ones((480, 640), np.float32))
    assert boxed.shape == (512, 512, 3)
    assert not boxed[:64].any()
    assert not depth[448:].any()
    assert boxed[64:448].all()


def test_scaling_inside_the_padding_is_scaling_with_it():
    rng = np.random.default_rng(0)
    rgb, depth = rng.integers(0, 256, (480, 640, 3)).astype(np.uint8), rng.uniform(0, 4, (480, 640)).astype(np.float32)
    square, far = np.zeros((640, 640, 3), np.uint8), np.zeros((640, 640), np.float32)
    square[80:560], far[80:560] = rgb, depth
    boxed, boxed_depth = letterbox(rgb, depth)
    np.testing.assert_array_equal(boxed, cv2.resize(square, (512, 512), interpolation=cv2.INTER_AREA))
    np.testing.assert_array_equal(boxed_depth, cv2.resize(far, (512, 512), interpolation=cv2.INTER_NEAREST_EXACT))


def test_right_size_is_handed_through():
    rgb, depth = np.zeros((512, 512, 3), np.uint8), np.zeros((512, 512), np.float32)
    boxed, _ = letterbox(rgb, depth)
    assert boxed is rgb


def test_colour_scaling_is_the_papers():
    rgb = np.random.default_rng(0).integers(0, 256, (2, 4, 6, 3)).astype(np.uint8)
    scaled = colour_input(rgb)
    assert scaled.dtype == np.float32
    np.testing.assert_allclose(scaled, np.moveaxis((rgb / 255 - 0.5) / 0.5, -1, 1), atol=1e-6)


def test_depth_scaling_is_a_plane_for_a_plane_and_far_for_nothing():
    inverse = np.linspace(0.2, 2.0, 7, dtype=np.float32)
    scaled = depth_input((1 / inverse)[None, None])[0, 0, 0]
    np.testing.assert_allclose(np.diff(scaled, 2), 0.0, atol=1e-6)
    assert depth_input(np.zeros((1, 2, 2))).max() == -1.0
    assert depth_input(np.full((1, 2, 2), 0.01)).max() == 1.0
    assert depth_input(np.full((1, 2, 2), np.nan)).max() == -1.0


def slope(height=128, width=160):
    """Inverse depth rises along both axes: (H, W) float32 metres."""
    v, u = np.mgrid[:height, :width].astype(np.float32)
    return 1.0 / (0.4 + 0.002 * u + 0.003 * v)


@pytest.mark.parametrize("share", [0.01, 0.05, 0.2, 0.35])
def test_single_holes_are_closed_with_what_is_around(share):
    depth = slope()
    holes = np.random.default_rng(0).random(depth.shape) < share
    closed = close_small_holes(np.where(holes, np.float32(0.0), depth))
    inner = closed[2:-2, 2:-2]
    assert (inner == 0.0).mean() < 0.01
    seen = inner > 0.0
    assert np.abs(inner - depth[2:-2, 2:-2])[seen].max() < 0.05
    np.testing.assert_array_equal(closed[~holes], depth[~holes])  # what was read stays as it is


def test_large_holes_stay_and_a_full_frame_is_handed_through():
    depth = slope()
    assert close_small_holes(depth) is depth
    holed = depth.copy()
    holed[40:90, 30:100] = 0.0
    closed = close_small_holes(holed)
    assert (closed[44:86, 34:96] == 0.0).all()
    assert not close_small_holes(np.zeros((16, 16), np.float32)).any()


def test_what_is_no_number_is_a_hole():
    depth = slope()
    depth[20, 20] = np.nan
    assert np.isfinite(close_small_holes(depth)).all()
