import math

import numpy as np
import pytest

from stair_env.common.validation import SpecError
from stair_env.intrinsics import D435I_COLOR_MODES, Intrinsics, letterbox_padding

MODES = list(D435I_COLOR_MODES.values())


@pytest.mark.parametrize("intrinsics", MODES)
def test_project_undoes_deproject(intrinsics):
    rng = np.random.default_rng(0)
    uv = rng.uniform([0, 0], [intrinsics.width, intrinsics.height], (50, 2))
    depth = rng.uniform(0.2, 5.0, 50)
    assert np.allclose(intrinsics.project(intrinsics.deproject(uv, depth)), uv)
    assert np.allclose(intrinsics.deproject(uv, depth)[:, 2], depth)


def test_rays_hit_pixel_centres():
    intrinsics = Intrinsics(6, 4, 7.0, 8.0, 2.5, 2.1)
    rays = intrinsics.rays()
    assert rays.shape == (4, 6, 3)
    assert np.allclose(intrinsics.project(rays)[2, 3], [3.5, 2.5])


def test_matrix_agrees_with_project():
    intrinsics = MODES[0]
    point = np.array([0.1, -0.2, 1.5])
    homogeneous = intrinsics.matrix @ point
    assert np.allclose(homogeneous[:2] / homogeneous[2], intrinsics.project(point))


def test_points_behind_have_no_image():
    assert np.isnan(MODES[0].project(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]))).all()


def test_field_of_view_round_trips():
    intrinsics = Intrinsics.from_fov(320, 240, math.radians(50))
    assert intrinsics.vertical_fov_rad == pytest.approx(math.radians(50))
    assert intrinsics.horizontal_fov_rad > intrinsics.vertical_fov_rad


def test_colour_field_of_view_is_the_data_sheets():
    wide = D435I_COLOR_MODES["1280x720"]
    assert math.degrees(wide.horizontal_fov_rad) == pytest.approx(69, abs=1.5)
    assert math.degrees(wide.vertical_fov_rad) == pytest.approx(42, abs=1.5)


@pytest.mark.parametrize(("width", "height"), [(640, 480), (848, 480), (480, 640), (853, 480), (512, 512)])
def test_letterbox_maps_points_as_padding_and_scaling_do(width, height):
    intrinsics = Intrinsics(width, height, 600.0, 610.0, width / 2 + 3, height / 2 - 2)
    point = np.array([0.2, 0.1, 1.3])
    left, top, side = letterbox_padding(width, height)
    expected = (intrinsics.project(point) + np.array([left, top])) * 512 / side
    assert np.allclose(intrinsics.letterboxed(512).project(point), expected)
    assert side == max(width, height)


def test_scaled_keeps_the_view():
    half = MODES[2].scaled(640, 360)
    assert half.horizontal_fov_rad == pytest.approx(MODES[2].horizontal_fov_rad)


def test_dict_round_trip():
    assert Intrinsics.from_dict(MODES[1].to_dict()) == MODES[1]


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ((0, 480, 600, 600, 320, 240), "width"),
        ((640, 480.5, 600, 600, 320, 240), "height"),
        ((640, 480, -1, 600, 320, 240), "fx"),
        ((640, 480, 600, float("nan"), 320, 240), "fy"),
        ((640, 480, 600, 600, 1e6, 240), "cx"),
        ((640, 480, 600, 600, 320, "a"), "cy"),
    ],
)
def test_wrong_values_are_named(values, named):
    with pytest.raises(SpecError, match=named):
        Intrinsics(*values)


@pytest.mark.parametrize("values", [[], {"width": 3}, {"focal": 3}])
def test_wrong_dicts_are_named(values):
    with pytest.raises(SpecError):
        Intrinsics.from_dict(values)
