import math

import numpy as np
import pytest

from stair_env.common.transforms import look_along, look_at
from stair_env.sensors.camera.renderers.base import check_pose


@pytest.mark.parametrize("pitch", [0.0, 0.4])
def test_look_along_points_where_it_says(pitch):
    pose = look_along(np.array([1.0, 2.0, 3.0]), 0.0, pitch)
    assert pose[:3, 2] == pytest.approx([math.cos(pitch), 0.0, -math.sin(pitch)])
    assert pose[:3, 0] == pytest.approx([0.0, -1.0, 0.0])
    assert pose[:3, 3] == pytest.approx([1.0, 2.0, 3.0])


def test_look_at_puts_the_target_on_the_optical_axis_and_keeps_the_horizon_level():
    eye, target = np.array([-1.0, 0.3, 0.5]), np.array([0.5, -0.2, 0.1])
    pose = check_pose(look_at(eye, target))
    in_camera = pose[:3, :3].T @ (target - eye)
    assert np.allclose(in_camera, [0, 0, np.linalg.norm(target - eye)])
    assert pose[2, 0] == pytest.approx(0.0)  # right is level
    assert pose[2, 1] < 0  # down is down


def test_look_at_rolls_clockwise():
    pose = look_at((0, 0, 0), (1, 0, 0), roll_rad=0.3)
    assert pose[2, 0] == pytest.approx(-np.sin(0.3))  # the camera's right side goes down


def test_look_at_refuses_the_vertical():
    with pytest.raises(ValueError, match="above or below"):
        look_at((0, 0, 0), (0, 0, 1))
