import numpy as np

from stair_env.common.transforms import look_at
from stair_env.intrinsics import Intrinsics
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.depth_error import DepthErrorConfig
from stair_env.sensors.camera.still import draw_device, draw_labelled
from stair_env.stairs import StairSpec

SMALL = Intrinsics(160, 120, 150.0, 150.0, 80.0, 60.0)


def test_a_frame_shows_the_edges_that_it_labels():
    frame, labels = draw_labelled(Scene(SceneSpec(StairSpec())), SMALL, look_at((-0.8, 0.0, 0.6), (0.5, 0.0, 0.2)))
    assert frame.rgb.shape == (120, 160, 3) and (frame.depth_m > 0.0).any()
    assert {label.kind for label in labels} == {"convex", "concave"}


def test_larger_images_take_longer_pieces_for_lines():
    scene, pose = Scene(SceneSpec(StairSpec())), look_at((-0.8, 0.0, 0.6), (0.5, 0.0, 0.2))
    counts = [len(draw_labelled(scene, SMALL, pose, label_scale=scale)[1]) for scale in (0.3, 1.0, 20.0)]
    assert counts == sorted(counts, reverse=True) and counts[-1] == 0


def test_the_same_seed_draws_the_same_device():
    config = DepthErrorConfig(scale_bias_range=0.02)
    biases = [draw_device(np.random.default_rng(seed), config)[0].scale_bias for seed in (1, 1, 2)]
    assert biases[0] == biases[1] != biases[2]
