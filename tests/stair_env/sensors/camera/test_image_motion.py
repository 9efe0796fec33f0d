import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stair_env.common.transforms import look_along
from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.sensors.camera.image_motion import image_motion_px, middle_distance_m, motion_between


def pose_at(x=0.0, height=0.6, pitch_down=0.5):
    """Camera that looks along world x and down."""
    return look_along(np.array([x, 0.0, height]), 0.0, pitch_down, 0.0)


def test_image_motion_matches_projection_of_a_fixed_point():
    intrinsics = D435I_COLOR_MODES["640x480"]
    before, now = pose_at(), pose_at(x=0.02)
    now[:3, :3] = now[:3, :3] @ Rotation.from_rotvec([0.01, -0.02, 0.0]).as_matrix()
    point = now @ [0.0, 0.0, 1.5, 1.0]
    seen_before = intrinsics.project((np.linalg.inv(before) @ point)[:3])
    seen_now = intrinsics.project((np.linalg.inv(now) @ point)[:3])
    np.testing.assert_allclose(image_motion_px(intrinsics, before, now, 1.5), seen_now - seen_before, atol=1e-9)


def test_turning_right_moves_the_image_left():
    right = pose_at()
    right[:3, :3] = right[:3, :3] @ Rotation.from_rotvec([0.0, 0.01, 0.0]).as_matrix()
    motion = image_motion_px(D435I_COLOR_MODES["640x480"], pose_at(), right, 1.0)
    assert motion[0] == pytest.approx(-615 * np.tan(0.01), rel=1e-3) and abs(motion[1]) < 1e-9
    behind = pose_at()
    behind[:3, :3] = behind[:3, :3] @ Rotation.from_rotvec([0.0, np.pi, 0.0]).as_matrix()
    np.testing.assert_array_equal(image_motion_px(D435I_COLOR_MODES["640x480"], behind, right, 1.0), 0.0)


def test_middle_distance_is_the_median_of_what_is_in_range():
    rng = np.random.default_rng(0)
    for size in ((64, 80), (480, 640), (17, 33)):
        depth = rng.uniform(0.0, 4.0, size).astype(np.float32)
        depth[rng.random(size) < 0.2] = 0.0
        sample = depth[::16, ::16]
        inside = sample[(sample >= 0.5) & (sample <= 3.0)]
        assert middle_distance_m(depth, 0.5, 3.0) == float(np.median(inside))
    assert middle_distance_m(np.zeros((40, 40), np.float32), 0.0, 7.0) == 7.0


def test_motion_between_two_poses_is_their_angle_and_distance():
    rng = np.random.default_rng(1)
    before, after = np.eye(4), np.eye(4)
    for angle in (0.0, 1e-6, 0.3, 3.1):
        before[:3, :3] = Rotation.random(random_state=2).as_matrix()
        axis = rng.standard_normal(3)
        turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
        after[:3, :3] = before[:3, :3] @ turn
        after[:3, 3] = before[:3, 3] + [0.3, -0.4, 1.2]
        assert motion_between(before, after) == pytest.approx((angle, 1.3), abs=1e-9)
