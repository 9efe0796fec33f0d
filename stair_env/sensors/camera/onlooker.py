"""What `render()` shows: the robot from the side, drawn by Bullet where Bullet moves it, else by the ray-caster."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from stair_env.scene.shapes import Shape
from stair_env.sensors.camera.renderers.base import SceneLike


class _Solids(Protocol):
    def shapes(self) -> list[Shape]: ...


class World(Protocol):
    """The part of `stair_env.physics.interface.Physics` that a picture needs."""

    @property
    def client(self) -> Any:
        """The Bullet client, or None."""

    def solids(self) -> _Solids:
        """The robot's solids."""


class Onlooker:
    """Takes pictures of one episode.

    Args:
        world: that moves the robot.
        scene: builds what stands around it, for the ray-caster; called once, and only if it draws.
    """

    def __init__(self, world: World, scene: Callable[[], SceneLike]) -> None:
        if world.client is not None:
            from stair_env.sensors.camera.third_person_bullet import BulletOnlooker

            self._look = BulletOnlooker(world.client).look
        else:
            from stair_env.sensors.camera.third_person import FollowCamera  # compiles on first use

            camera, solids = FollowCamera(scene()), world.solids()
            self._look = lambda target: camera.look_with_depth(target, solids.shapes())

    def look(self, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take a picture.

        Args:
            target: (3,) what to look at, world, metres.

        Returns:
            uint8 (480, 640, 3) and float32 (480, 640) distance along the view axis, metres.
        """
        return self._look(target)
