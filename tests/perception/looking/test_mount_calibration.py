"""A mount is found from a floor and from stairs, with noise, within what it claims; of walls nothing is claimed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from perception.looking.mount_calibration import CalibrationFailed, calibrate_mount, camera_to_trunk, mount_angles
from stair_env.common.transforms import look_along
from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.renderers.factory import make_renderer
from stair_env.stairs import StairSpec

CAMERA = D435I_COLOR_MODES["640x480"]


def plane(pitch_down: float, roll: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Depth of a floor, and gravity, of a camera on a level trunk."""
    up = camera_to_trunk(pitch_down, roll)[2]
    along = -(CAMERA.rays() @ up)
    depth = np.where(along > 0.05, height / np.maximum(along, 0.05), 0.0).astype(np.float32)
    return np.where(depth < 8.0, depth, 0.0), 9.8 * up


def noisy(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A stereo camera's noise: of inverse depth, correlated over some pixels."""
    import cv2

    noise = cv2.GaussianBlur(rng.normal(0.0, 1.0, depth.shape), (0, 0), 3.0)
    noise *= 0.0035 / noise.std()  # 3.5 mm at 1 m
    return np.where(depth > 0.0, depth / (1.0 + noise * depth), 0.0).astype(np.float32)


@pytest.mark.parametrize("pitch_deg, roll_deg, height", [(25.0, 0.0, 0.4), (35.0, 4.0, 0.9), (50.0, -6.0, 0.3)])
@pytest.mark.parametrize("knows_gravity", [True, False])
def test_a_floor(pitch_deg: float, roll_deg: float, height: float, knows_gravity: bool) -> None:
    depth, gravity = plane(math.radians(pitch_deg), math.radians(roll_deg), height)
    rng = np.random.default_rng(0)
    given = gravity if knows_gravity else None
    mount = calibrate_mount([(noisy(depth, rng), CAMERA, given) for _ in range(5)])
    assert abs(math.degrees(mount.pitch_down_rad) - pitch_deg) < 0.25
    assert abs(math.degrees(mount.roll_rad) - roll_deg) < 0.25
    assert abs(mount.height_m - height) < 0.004
    assert mount.levels == 1 and mount.frames == 5
    assert 0.0 < math.degrees(mount.pitch_std_rad) < 0.3 and 0.0 < mount.height_std_m < 0.006


@pytest.mark.parametrize("direction", ["up", "down"])
def test_stairs(direction: str) -> None:
    scene = Scene(SceneSpec(StairSpec(direction=direction, riser_height=0.15, tread_depth=0.30)))  # type: ignore[arg-type]
    floor = float(scene.spec.stairs.profile().level_z[0])  # type: ignore[union-attr]
    pose = look_along(np.array([-0.8, 0.0, floor + 0.6]), 0.15, 0.6, 0.04)
    drawn = make_renderer("raycast", scene).render(CAMERA, pose)
    rng = np.random.default_rng(1)
    mount = calibrate_mount([(noisy(drawn.depth_m, rng), CAMERA, 9.8 * pose[2, :3]) for _ in range(3)])
    assert abs(math.degrees(mount.pitch_down_rad - 0.6)) < 0.4
    assert abs(math.degrees(abs(mount.roll_rad) - 0.04)) < 0.4
    assert abs(mount.height_m - 0.6) < 0.008
    assert mount.levels > 1


def test_a_trunk_that_is_not_level() -> None:
    rotation = camera_to_trunk(0.5, 0.1)
    trunk_up = np.array([0.1, -0.05, 1.0]) / np.linalg.norm([0.1, -0.05, 1.0])
    assert np.allclose(mount_angles(rotation.T @ trunk_up, trunk_up), (0.5, 0.1), atol=1e-6)
    depth, gravity = plane(0.5, 0.1, 0.5)
    assert math.isclose(calibrate_mount([(depth, CAMERA, gravity)]).pitch_down_rad, 0.5, abs_tol=1e-3)


def test_the_uncertainty_is_one() -> None:
    """Of many calibrations, most lie within two standard deviations."""
    depth, gravity = plane(0.5, 0.0, 0.5)
    rng = np.random.default_rng(2)
    mounts = [calibrate_mount([(noisy(depth, rng), CAMERA, gravity) for _ in range(2)]) for _ in range(8)]
    good = [
        abs(m.pitch_down_rad - 0.5) < 2 * m.pitch_std_rad and abs(m.height_m - 0.5) < 2 * m.height_std_m for m in mounts
    ]
    assert np.mean(good) >= 0.85


@pytest.mark.parametrize("depth", [np.zeros((480, 640), np.float32), np.full((480, 640), 1.5, np.float32)])
def test_walls_and_nothing_are_no_floor(depth: np.ndarray) -> None:
    with pytest.raises(CalibrationFailed, match="level"):
        calibrate_mount([(depth, CAMERA, np.array([0.0, -9.8, 0.0]))])
    with pytest.raises(CalibrationFailed, match="no frames"):
        calibrate_mount([])
