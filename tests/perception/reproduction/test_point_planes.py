import numpy as np
import pytest

from perception.reproduction.point_planes import PointPlanesConfig, measure_point_planes
from perception.reproduction.table7_geometry import _frame_with_steps, dress, steps_of
from stair_env.common.validation import SpecError
from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.scene.paper_stairs import PAPER_STAIRS
from stair_env.scene.spec import Scene

CAMERA = D435I_COLOR_MODES["640x480"]
LEVEL = np.array([0.0, -9.81, 0.0])


@pytest.fixture(scope="module")
def exact():
    """Frames without errors: (direction, profile, pose, depth)."""
    rng = np.random.default_rng(0)
    frames = []
    for direction in ("up", "down"):
        for stair in PAPER_STAIRS[:3]:
            spec = stair.spec(direction)
            pose, frame, _ = _frame_with_steps(spec, Scene(dress(spec, "day", rng)), rng, CAMERA)
            frames.append((direction, spec.profile(), pose, frame.depth_m))
    return frames


def test_exact_depth_gives_steps_to_centimetres(exact):
    """Of most frames: a tread that is hardly seen is no plane."""
    errors, valid = [], 0
    for direction, profile, pose, depth in exact:
        estimate = measure_point_planes(depth, CAMERA, 9.81 * pose[2, :3])
        assert estimate.direction in (0, 1 if direction == "up" else -1)
        valid += estimate.valid
        for index, width, height in steps_of(estimate, profile, float(pose[0, 3])):
            errors.append((width - np.diff(profile.edge_x)[index], height - abs(profile.rises[index])))
    assert valid >= 4 and len(errors) >= 6
    width, height = np.median(np.abs(errors), axis=0)
    assert width < 0.03 and height < 0.005


def test_yaw_is_that_of_the_camera(exact):
    for direction, _, pose, depth in exact:
        if direction == "up":  # going down no riser is seen
            yaw = -np.arctan2(pose[1, 2], pose[0, 2])
            assert abs(measure_point_planes(depth, CAMERA, 9.81 * pose[2, :3]).yaw_rad - yaw) < np.radians(3.0)


def test_nothing_and_a_wall_are_no_stairs():
    for depth in (np.zeros((480, 640), np.float32), np.full((480, 640), 1.5, np.float32)):
        estimate = measure_point_planes(depth, CAMERA, LEVEL)
        assert not estimate.valid and estimate.reason and not estimate.steps


def test_small_planes_do_not_count(exact):
    _, _, pose, depth = exact[0]
    estimate = measure_point_planes(depth, CAMERA, 9.81 * pose[2, :3], PointPlanesConfig(least_area_m2=5.0))
    assert estimate.reason == "fewer than two level planes"


@pytest.mark.parametrize("wrong", [{"max_distance_m": 0.0}, {"least_area_m2": -1.0}])
def test_wrong_values_are_named(wrong):
    with pytest.raises(SpecError, match=next(iter(wrong))):
        PointPlanesConfig(**wrong)
