"""Renderers by name."""

from __future__ import annotations

from typing import Any

from stair_env.common.validation import check_choice
from stair_env.sensors.camera.renderers.base import Renderer, SceneLike

RENDERERS: tuple[str, ...] = ("raycast", "tiny", "egl")


def make_renderer(name: str, scene: SceneLike, client: Any = None, **options: Any) -> Renderer:
    """Build a renderer.

    Args:
        name: "raycast" (own, compiled, exact; needs no PyBullet), "tiny" (PyBullet's TinyRenderer) or "egl"
            (PyBullet's OpenGL plugin).
        scene: what stands still.
        client: the PyBullet client that holds the same scene as bodies; needed by "tiny" and "egl".
        options: keyword arguments of the renderer's class.

    Raises:
        SpecError: no renderer of that name (a ValueError).
        ValueError: "tiny" or "egl" without a client.
        RuntimeError: "egl" cannot be loaded on this machine.
    """
    check_choice("renderer", name, RENDERERS)
    if name == "raycast":
        from stair_env.sensors.camera.renderers.raycast import RaycastRenderer  # compiles on first use

        return RaycastRenderer(scene, **options)
    if client is None:
        raise ValueError(f"renderer {name!r} draws the bodies of a PyBullet client: pass client=")
    from stair_env.sensors.camera.renderers.bullet import BulletRenderer

    return BulletRenderer(scene, client, hardware=name == "egl", **options)
