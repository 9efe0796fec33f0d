"""The film's camera keeps the robot in view."""

from __future__ import annotations

import numpy as np

from stair_env.camera.follower import FollowCamera
from stair_env.sampling import Scene, SceneSpec
from stair_env.scene import Shape
from stair_env.stairs import StairSpec

ROBOT = Shape("box", (-0.8, 0.0, 0.4), (0.3, 0.15, 0.1), surface="robot")
POSITION = np.array(ROBOT.position)


def robot_pixels(camera: FollowCamera) -> int:
    picture = camera.look(POSITION, [ROBOT])
    assert picture.shape == (480, 640, 3) and picture.dtype == np.uint8
    empty = camera._frame(POSITION, [], camera._side).rgb
    return int((picture != empty).any(axis=2).sum())


def test_the_robot_is_in_the_picture() -> None:
    assert robot_pixels(FollowCamera(Scene(SceneSpec(StairSpec())))) > 5000


def test_a_wall_in_the_way_makes_the_camera_change_sides() -> None:
    camera = FollowCamera(Scene(SceneSpec(StairSpec(side_walls="right"))))
    seen = camera._side
    inside = Shape("box", (0.6, 0.0, 0.6), (0.3, 0.15, 0.1), surface="robot")
    camera.look(np.array(inside.position), [inside])
    assert camera._side == -seen
