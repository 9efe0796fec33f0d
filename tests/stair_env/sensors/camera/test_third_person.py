"""The film's camera keeps the robot in view."""

from __future__ import annotations

import numpy as np
import pytest

from stair_env.sampling import Scene, SceneSpec
from stair_env.scene.shapes import Shape
from stair_env.sensors.camera.third_person import COMFORTABLE_LEVEL, MAX_GAIN, FollowCamera, adapt
from stair_env.stairs import StairSpec

ROBOT = Shape("box", (-0.8, 0.0, 0.4), (0.3, 0.15, 0.1), surface="robot")


def shown(camera: FollowCamera, robot: Shape) -> int:
    """Pixels of the robot in the camera's next picture."""
    position = np.array(robot.position)
    picture = camera.look(position, [robot])
    assert picture.shape == (480, 640, 3) and picture.dtype == np.uint8
    return camera._robot_pixels(camera._frame(position, [robot], camera._eye))


def test_the_robot_is_in_the_picture() -> None:
    assert shown(FollowCamera(Scene(SceneSpec(StairSpec()))), ROBOT) > 5000


@pytest.mark.parametrize("walls", ["left", "right", "both"])
def test_walls_do_not_hide_the_robot(walls: str) -> None:
    inside = Shape("box", (0.6, 0.0, 0.6), (0.3, 0.15, 0.1), surface="robot")
    camera = FollowCamera(Scene(SceneSpec(StairSpec(side_walls=walls, flight_width=1.2))))  # type: ignore[arg-type]
    assert shown(camera, inside) > 3000


def test_the_camera_stays_where_the_view_is_clear() -> None:
    camera = FollowCamera(Scene(SceneSpec(StairSpec())))
    eyes = set()
    for x in np.linspace(-0.8, 1.0, 10):
        moved = Shape("box", (x, 0.0, 0.5), (0.3, 0.15, 0.1), surface="robot")
        shown(camera, moved)
        eyes.add(camera._eye)
    assert len(eyes) == 1


def test_dark_pictures_are_brightened_and_light_ones_left_alone() -> None:
    rng = np.random.default_rng(0)
    light = rng.integers(100, 255, (64, 64, 3), dtype=np.uint8)
    assert adapt(light) is light
    dim = (light // 8).astype(np.uint8)
    assert np.percentile(adapt(dim), 90) == pytest.approx(COMFORTABLE_LEVEL, rel=0.1)
    black = np.full((64, 64, 3), 2, np.uint8)
    assert adapt(black).max() == 2 * MAX_GAIN
