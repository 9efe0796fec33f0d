import numpy as np
import pytest

from stair_env.env import StairClimbEnv
from stair_env.scene.shapes import Shape
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.onlooker import Onlooker
from stair_env.stairs import StairSpec

BALL = Shape("sphere", (-0.5, 0.0, 0.4), (0.2, 0.0, 0.0), surface="robot")


class Balls:
    """A world without Bullet, of one ball."""

    client = None

    def solids(self):
        return self

    def shapes(self):
        return [BALL]


def test_without_a_client_the_ray_caster_draws_the_scene_it_is_given():
    asked = []

    def scene():
        asked.append(1)
        return Scene(SceneSpec(StairSpec()))

    onlooker = Onlooker(Balls(), scene)
    for _ in range(2):
        colour, depth = onlooker.look(np.array(BALL.position))
    assert asked == [1] and colour.shape == (480, 640, 3) and colour.dtype == np.uint8
    assert depth.shape == (480, 640) and depth.dtype == np.float32
    assert depth[200:280, 280:360].min() == pytest.approx(1.7, abs=0.4)  # the ball, from an eye 1.9 m away


def test_with_a_client_bullet_draws_and_no_scene_is_built():
    env = StairClimbEnv(render_mode="rgb_array")
    env.reset(seed=0)

    def scene():
        raise AssertionError("asked for a scene")

    colour, depth = Onlooker(env.simulation, scene).look(np.array([-0.5, 0.0, 0.4]))
    assert np.array_equal(colour, Onlooker(env.simulation, scene).look(np.array([-0.5, 0.0, 0.4]))[0])
    assert colour.shape == (480, 640, 3) and depth.min() > 0.05
    env.close()
