import json

import numpy as np
import pytest

from stair_env.sensors.camera.stereo import StereoConfig


def test_random_cameras_are_valid_and_differ():
    rng = np.random.default_rng(0)
    drawn = [StereoConfig.random(rng) for _ in range(300)]
    assert len(set(drawn)) == 300
    assert {camera.matcher for camera in drawn} == {"bm", "sgbm"}
    assert {camera.mode for camera in drawn} == {"640x480", "848x480", "1280x720"}
    assert {camera.hole_filling for camera in drawn} == {"none", "left", "far", "near"}
    for camera in drawn[:50]:
        assert StereoConfig.from_dict(json.loads(json.dumps(camera.to_dict()))) == camera


def test_a_random_camera_takes_its_numbers_from_the_generator_alone():
    assert StereoConfig.random(np.random.default_rng(5)) == StereoConfig.random(np.random.default_rng(5))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("mode", "424x240"),
        ("matcher", "census"),
        ("hole_filling", "up"),
        ("block_px", 8),
        ("block_px", 7.0),
        ("max_disparity_px", 100),
        ("uniqueness", True),
        ("ambient_gain", [3.0, 1.0]),
        ("ambient_gain", 1.0),
        ("smoothness", [1.0, 2.0, 3.0]),
        ("decimation", 9),
        ("persistency", 9),
        ("min_range_m", 4.9),
        ("infrared_contrast", float("nan")),
        ("lens", 1.0),
    ],
)
def test_wrong_config_is_named(field, value):
    values = {field: value, "max_range_m": 4.0} if field == "min_range_m" else {field: value}
    with pytest.raises(ValueError, match=field):
        StereoConfig.from_dict(values)
