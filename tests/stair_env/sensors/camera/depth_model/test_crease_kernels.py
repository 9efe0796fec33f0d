import numpy as np
import pytest

from stair_env.sensors.camera.depth_model.crease_kernels import round_creases

H, W = 60, 90


def rounded(disparity, half, limit=0.75, measured=None):
    out = (disparity if measured is None else measured).copy()
    round_creases(disparity, half, np.float32(limit), np.zeros((4, W + 8), np.float32), out)
    return out


def ramp(per_row, per_column=0.0):
    v, u = np.mgrid[:H, :W]
    return (20.0 + per_row * v + per_column * u).astype(np.float32)


@pytest.mark.parametrize("half", [1, 2, 3, 6, 9, 20])
def test_planes_pass_bit_by_bit_up_to_the_border(half):
    plane = ramp(0.07, -0.03)
    np.testing.assert_array_equal(rounded(plane, half), plane)


@pytest.mark.parametrize("half", [1, 2, 3, 4, 5, 6, 7])
def test_a_crease_becomes_the_mean_over_the_window(half):
    v = np.arange(H)
    crease = np.repeat((20.0 + 0.1 * np.abs(v - 30))[:, None], W, axis=1).astype(np.float32)
    out = rounded(crease, half)
    for row in range(30 - half, 31 + half):
        assert out[row, 40] == pytest.approx(crease[row - half : row + half + 1, 40].mean(), abs=3e-3)
    far = np.abs(v - 30) > half
    np.testing.assert_array_equal(out[far], crease[far])


def test_any_window_is_a_mean_over_rows_and_columns():
    rng = np.random.default_rng(0)
    rough = (20.0 + 0.1 * rng.standard_normal((H, W))).astype(np.float32)
    out = rounded(rough, 4, 10.0)
    changed = rough[16:25, 26:35].mean()
    assert out[20, 30] == pytest.approx(changed, abs=2.5e-3)


def test_jumps_and_shadows_stay():
    jump = np.where(np.arange(W) < 45, np.float32(10.0), np.float32(30.0)) * np.ones((H, 1), np.float32)
    out = rounded(jump, 4)
    assert np.abs(out - jump).max() < 0.75
    np.testing.assert_array_equal(out[:, 41:49], jump[:, 41:49])
    hidden = jump.copy()
    hidden[10:20, 30:50] = 0.0
    np.testing.assert_array_equal(rounded(jump, 4, measured=hidden) == 0.0, hidden == 0.0)


@pytest.mark.parametrize("parts", [2, 3, 7])
@pytest.mark.parametrize("half", [1, 4, 9])
def test_rows_worked_on_in_parts_are_the_same_bits(half, parts):
    rough = (20.0 + 0.1 * np.random.default_rng(1).standard_normal((H, W))).astype(np.float32)
    whole, divided = rounded(rough, half), rough.copy()
    for part in reversed(range(parts)):
        begin, end = (H * edge // parts for edge in (part, part + 1))
        round_creases(rough, half, np.float32(0.75), np.zeros((4, W), np.float32), divided, begin, end)
    np.testing.assert_array_equal(divided, whole)
