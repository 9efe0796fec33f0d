"""The third-person picture of films: ray-cast, with the scene's materials and light, from whichever side is clear."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stair_env.camera.intrinsics import Intrinsics
from stair_env.camera.renderers.base import Frame, SceneLike, look_at
from stair_env.camera.renderers.factory import make_renderer
from stair_env.scene import Shape

WIDTH, HEIGHT = 640, 480
FIELD_OF_VIEW_RAD = np.radians(54.0)  # vertical
BEHIND_M, ASIDE_M, ABOVE_M = 1.1, 1.5, 0.6  # of the eye from the robot
AHEAD_M, BELOW_M = 0.25, 0.10  # of the point looked at
HIDDEN_SHARE = 0.5  # the side changes when the other one shows the robot this much better
SIDES = (-1.0, 1.0)  # right, left


class FollowCamera:
    """Walks along with a robot.

    Args:
        scene: what stands still.
    """

    def __init__(self, scene: SceneLike) -> None:
        self._renderer = make_renderer("raycast", scene)
        self._first_moving = len(scene.shapes)
        focal = HEIGHT / 2 / float(np.tan(FIELD_OF_VIEW_RAD / 2))
        self._intrinsics = Intrinsics(WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2)
        self._side = SIDES[0]

    def look(self, position: np.ndarray, moving: Sequence[Shape]) -> np.ndarray:
        """Take a picture.

        Args:
            position: (3,) of the robot, world, metres.
            moving: its solids.

        Returns:
            uint8 (480, 640, 3).
        """
        frame = self._frame(position, moving, self._side)
        other = self._frame(position, moving, -self._side)
        if self._robot_pixels(frame) < HIDDEN_SHARE * self._robot_pixels(other):
            self._side, frame = -self._side, other
        return frame.rgb

    def _frame(self, position: np.ndarray, moving: Sequence[Shape], side: float) -> Frame:
        eye = position + np.array([-BEHIND_M, side * ASIDE_M, ABOVE_M])
        target = position + np.array([AHEAD_M, 0.0, -BELOW_M])
        return self._renderer.render(self._intrinsics, look_at(eye.tolist(), target.tolist()), moving=moving)

    def _robot_pixels(self, frame: Frame) -> int:
        return int((frame.segmentation >= self._first_moving).sum())
