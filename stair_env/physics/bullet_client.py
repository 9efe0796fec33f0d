"""A Bullet client that keeps quiet."""

from __future__ import annotations

import os
from typing import Any

import pybullet
from pybullet_utils.bullet_client import BulletClient

from stair_env.common.console import stdout_to_stderr


class QuietBulletClient(BulletClient):
    """A Bullet client that prints nothing on standard output, which belongs to the program that runs the simulation.

    Args:
        mode: `pybullet.GUI` or `pybullet.DIRECT`.
    """

    def __init__(self, mode: int) -> None:
        self._shapes: dict[Any, Any] = {}
        self._pid = os.getpid()
        self._client = -1
        if mode == pybullet.DIRECT:
            self._client = pybullet.connect(mode)  # without an options string, which would be echoed
            return
        with stdout_to_stderr():
            self._client = pybullet.connect(mode)
