import numpy as np
import pytest

from stair_env.sensors.camera.renderers.base import check_pose


@pytest.mark.parametrize(
    "pose",
    [
        np.eye(3),
        np.full((4, 4), np.nan),
        np.diag([2.0, 1, 1, 1]),
        np.diag([-1.0, 1, 1, 1]),
        np.diag([1.0, 1, 1, 2]),
    ],
)
def test_a_pose_that_is_no_rigid_transform_is_refused(pose):
    with pytest.raises(ValueError, match="camera_to_world"):
        check_pose(pose)
