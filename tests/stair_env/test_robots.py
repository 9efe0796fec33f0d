import numpy as np
import pytest

from stair_env.robots import ROBOTS, mount_to_base


def test_mount_points_the_camera_forward_and_down():
    transform = mount_to_base(ROBOTS["aliengo"].camera)
    right, down, forward = transform[:3, :3].T
    assert right == pytest.approx([0, -1, 0])
    assert forward[0] > 0.85 and forward[2] < -0.3 and down[2] < -0.85
    assert np.linalg.det(transform[:3, :3]) == pytest.approx(1.0)
