"""The third-person picture of `render()`: Bullet's software renderer, which knows the robot's meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pybullet

WIDTH, HEIGHT = 640, 480
NEAR_M, FAR_M = 0.05, 20.0
FIELD_OF_VIEW_DEG = 50.0
AIM_OFFSET_M = (0.25, 0.0, -0.05)  # a little ahead of the trunk, where it is going


class BulletOnlooker:
    """Looks at the robot from the side, a little from behind and above.

    Args:
        client: Bullet client.
    """

    def __init__(self, client: Any) -> None:
        self._client = client

    def look(self, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take a picture.

        Args:
            target: (3,) what to look at, world, metres.

        Returns:
            uint8 (480, 640, 3) and float32 (480, 640) distance along the view axis, metres.
        """
        client = self._client
        view = client.computeViewMatrixFromYawPitchRoll(
            cameraTargetPosition=np.add(target, AIM_OFFSET_M).tolist(),
            distance=1.9,
            yaw=-28.0,
            pitch=-16.0,
            roll=0.0,
            upAxisIndex=2,
        )
        projection = client.computeProjectionMatrixFOV(FIELD_OF_VIEW_DEG, WIDTH / HEIGHT, NEAR_M, FAR_M)
        _, _, colour, depth, _ = client.getCameraImage(
            WIDTH,
            HEIGHT,
            view,
            projection,
            lightDirection=(-0.6, -1.0, 1.6),
            shadow=1,
            renderer=pybullet.ER_TINY_RENDERER,
        )
        buffer = np.asarray(depth, np.float32).reshape(HEIGHT, WIDTH)
        metres = FAR_M * NEAR_M / (FAR_M - (FAR_M - NEAR_M) * buffer)
        return np.asarray(colour, np.uint8).reshape(HEIGHT, WIDTH, 4)[..., :3].copy(), metres.astype(np.float32)
