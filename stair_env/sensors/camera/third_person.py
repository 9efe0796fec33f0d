"""The third-person picture of films: ray-cast, with the scene's materials and light, from where the view is clear."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stair_env.common.transforms import look_at
from stair_env.intrinsics import Intrinsics
from stair_env.scene.shapes import Shape
from stair_env.sensors.camera.renderers.base import Frame, SceneLike
from stair_env.sensors.camera.renderers.factory import make_renderer

WIDTH, HEIGHT = 640, 480
FIELD_OF_VIEW_RAD = np.radians(54.0)  # vertical
EYES_M = ((-1.1, -1.5, 0.6), (-1.1, 1.5, 0.6), (-1.7, 0.25, 0.75))  # from the robot: its right, its left, behind it
TARGET_M = (0.25, 0.0, -0.10)  # what is looked at, from the robot
HIDDEN_SHARE = 0.5  # the place changes when another one shows so much more of the robot
LOOKS_PER_CHECK = 6
COMFORTABLE_LEVEL = 120.0  # an onlooker's eye adapts until the lighter parts of the picture reach this
MAX_GAIN = 6.0


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
        self._eye = EYES_M[0]
        self._looks = 0

    def look(self, position: np.ndarray, moving: Sequence[Shape]) -> np.ndarray:
        """Take a picture.

        Args:
            position: (3,) of the robot, world, metres.
            moving: its solids.

        Returns:
            uint8 (480, 640, 3).
        """
        return self.look_with_depth(position, moving)[0]

    def look_with_depth(self, position: np.ndarray, moving: Sequence[Shape]) -> tuple[np.ndarray, np.ndarray]:
        """Take a picture as `look` does, and with it float32 (480, 640) distance along the view axis, metres."""
        if self._looks % LOOKS_PER_CHECK == 0:
            self._choose_eye(position, moving)
        self._looks += 1
        frame = self._frame(position, moving, self._eye)
        return adapt(frame.rgb), frame.depth_m

    def _choose_eye(self, position: np.ndarray, moving: Sequence[Shape]) -> None:
        shown = {eye: self._robot_pixels(self._frame(position, moving, eye)) for eye in EYES_M}
        if shown[self._eye] < HIDDEN_SHARE * max(shown.values()):
            self._eye = max(shown, key=lambda eye: shown[eye])

    def _frame(self, position: np.ndarray, moving: Sequence[Shape], eye: tuple[float, float, float]) -> Frame:
        pose = look_at((position + eye).tolist(), (position + TARGET_M).tolist())
        return self._renderer.render(self._intrinsics, pose, moving=moving)

    def _robot_pixels(self, frame: Frame) -> int:
        return int((frame.segmentation >= self._first_moving).sum())


def adapt(rgb: np.ndarray) -> np.ndarray:
    """Brighten a dark picture uint8 (H, W, 3), as an eye does that has been in the dark for a while."""
    level = float(np.percentile(rgb[::8, ::8], 90.0))
    gain = min(COMFORTABLE_LEVEL / max(level, 1.0), MAX_GAIN)
    return rgb if gain <= 1.0 else np.minimum(rgb * np.float32(gain), 255.0).astype(np.uint8)
