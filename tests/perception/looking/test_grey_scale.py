"""The scale of 8-bit depth is found from steps that follow the rule, and what does not show steps gives none."""

from __future__ import annotations

import numpy as np
import pytest

from perception.estimator import StairEstimator
from perception.looking.grey_scale import STEP_RULE_M, estimate_grey_level
from perception.reproduction.ideal_detector import IdealDetector
from stair_env.common.transforms import look_along
from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.labels import visible_edges
from stair_env.sensors.camera.renderers.factory import make_renderer
from stair_env.stairs import StairSpec

CAMERA = D435I_COLOR_MODES["640x480"]
RISER_M, TREAD_M = 0.165, STEP_RULE_M - 2 * 0.165


@pytest.mark.parametrize("level_m", [0.008, 0.012])
def test_steps_that_follow_the_rule_give_the_scale(level_m: float) -> None:
    scene = Scene(SceneSpec(StairSpec(riser_height=RISER_M, tread_depth=TREAD_M)))
    pose = look_along(np.array([-0.8, 0.0, 0.9]), 0.05, 0.45, 0.0)
    drawn = make_renderer("raycast", scene).render(CAMERA, pose)
    levels = np.where(drawn.depth_m < 255 * level_m, np.rint(drawn.depth_m / level_m), 0).astype(np.uint8)
    labels = visible_edges(scene.edges, CAMERA, pose, drawn)
    detector = IdealDetector()
    for _ in range(20):
        detector.show(labels, CAMERA.width, CAMERA.height)
    found = estimate_grey_level(drawn.rgb, levels, CAMERA, 9.8 * pose[2, :3], StairEstimator(detector=detector))
    assert found is not None
    assert abs(found[0] / level_m - 1.0) < 0.06
    assert 0.0 < found[1] < 0.1 * level_m


def test_a_picture_without_steps_gives_none() -> None:
    class Nothing:
        def detect(self, rgb, depth_m):  # type: ignore[no-untyped-def]
            return np.zeros((len(rgb), 32, 16)), np.zeros((len(rgb), 32, 16, 8))

    rgb, levels = np.zeros((480, 640, 3), np.uint8), np.full((480, 640), 200, np.uint8)
    gravity = np.array([0.0, -9.8, 0.0])
    assert estimate_grey_level(rgb, levels, CAMERA, gravity, StairEstimator(detector=Nothing())) is None
