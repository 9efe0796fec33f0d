"""The sensors' default renderer: our own, compiled, exact, without PyBullet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stair_env.camera.intrinsics import Intrinsics
from stair_env.camera.renderers import visibility
from stair_env.camera.renderers.base import FAR_M, NEAR_M, Frame, SceneLike, check_pose
from stair_env.camera.renderers.solids import Solids
from stair_env.camera.renderers.threads import run_rows
from stair_env.scene import Shape


class RaycastRenderer:
    """Casts one ray through every pixel centre.

    Args:
        scene: what stands still.
        threads: number of threads to draw with; None for numba's setting (NUMBA_NUM_THREADS, else all cores).

    Raises:
        ValueError: threads is not positive.
    """

    def __init__(self, scene: SceneLike, *, threads: int | None = None) -> None:
        if threads is not None and threads < 1:
            raise ValueError(f"threads={threads!r} must be at least 1, or None")
        self._threads = threads
        self._static = Solids.from_shapes(scene.shapes)

    def render(self, intrinsics: Intrinsics, camera_to_world: np.ndarray, *, moving: Sequence[Shape] = ()) -> Frame:
        """Draw a frame; see `Renderer.render`."""
        pose = check_pose(camera_to_world)
        solids = self._static.joined(Solids.from_shapes(moving)) if moving else self._static
        m, o = visibility.to_camera(solids.rotations, solids.centres, pose)
        depth = np.empty((intrinsics.height, intrinsics.width), np.float32)
        ids = np.empty((intrinsics.height, intrinsics.width), np.int32)
        rx = ((np.arange(intrinsics.width) + 0.5 - intrinsics.cx) / intrinsics.fx).astype(np.float32)
        ry = ((np.arange(intrinsics.height) + 0.5 - intrinsics.cy) / intrinsics.fy).astype(np.float32)
        near, far = np.float32(NEAR_M), np.float32(FAR_M)

        def trace(rows: np.ndarray) -> None:
            visibility.trace_rows(
                rows, rx, ry, solids.kinds, solids.sizes, solids.bounds, m, o, near, far, depth, ids
            )  # fmt: skip

        run_rows(trace, -(-intrinsics.height // visibility.TILE), self._threads)
        rgb = np.where(ids[..., None] < 0, 200, 60 + (ids[..., None] * np.array([37, 61, 23])) % 160).astype(np.uint8)
        return Frame(rgb, depth, ids)

    def close(self) -> None:
        """Nothing to release."""
