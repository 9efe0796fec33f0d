"""The sensors' default renderer: our own, compiled, exact, without PyBullet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from stair_env.appearance import AppearanceSpec
from stair_env.camera.intrinsics import Intrinsics
from stair_env.camera.renderers import shading, visibility
from stair_env.camera.renderers.base import FAR_M, NEAR_M, Frame, SceneLike, check_pose
from stair_env.camera.renderers.looks import LookTable, across, light_settings
from stair_env.camera.renderers.solids import Solids
from stair_env.camera.renderers.threads import run_rows
from stair_env.scene import Shape


@dataclass(frozen=True)
class _Drawn:
    """Solids with what shading needs of them; see `shading.shade_rows`."""

    kinds: np.ndarray
    sizes: np.ndarray
    bounds: np.ndarray
    rotations: np.ndarray
    centres: np.ndarray
    shifts: np.ndarray
    looks: np.ndarray
    low: np.ndarray
    high: np.ndarray
    side: np.ndarray

    def joined(self, other: _Drawn) -> _Drawn:
        """These solids, then the other ones."""
        names = [field.name for field in fields(self)]
        return _Drawn(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in names))


class RaycastRenderer:
    """Casts one ray through every pixel centre.

    Args:
        scene: what stands still.
        appearance: materials and light; None for the scene's own (`scene.spec.appearance`), or the default ones.
        shadows: whether the light casts shadows, if the appearance has it so.
        textures: whether surfaces show their texture or its mean colour.
        threads: number of threads to draw with; None for numba's setting (NUMBA_NUM_THREADS, else all cores).

    Raises:
        ValueError: threads is not positive.
        SpecError: a shape's kind or surface is unknown.
    """

    def __init__(
        self,
        scene: SceneLike,
        *,
        appearance: AppearanceSpec | None = None,
        shadows: bool = True,
        textures: bool = True,
        threads: int | None = None,
    ) -> None:
        if threads is not None and threads < 1:
            raise ValueError(f"threads={threads!r} must be at least 1, or None")
        self._threads = threads
        if appearance is None:
            appearance = getattr(getattr(scene, "spec", None), "appearance", None) or AppearanceSpec()
        self._light = light_settings(appearance, shadows)
        self._side = across(np.array(appearance.light_direction))
        self._table = LookTable(appearance, textures)
        self._static = self._prepare(scene.shapes, fixed=True)

    def _prepare(self, shapes: Sequence[Shape], fixed: bool) -> _Drawn:
        solids = Solids.from_shapes(shapes)
        rotations, centres = solids.rotations, solids.centres
        reach = np.einsum("nij,nj->ni", np.abs(rotations), solids.bounds)
        middle_side = centres @ self._side.T
        reach_side = np.einsum("nsa,na->ns", np.abs(self._side @ rotations), solids.bounds)
        side = np.stack([middle_side - reach_side, middle_side + reach_side], axis=-1).reshape(-1, 4)
        # Textures of fixed solids are laid out in the world, so that they go on from one piece of a wall to the next.
        shifts = np.einsum("nji,nj->ni", rotations, centres) if fixed else np.zeros_like(centres)
        return _Drawn(
            solids.kinds,
            solids.sizes,
            solids.bounds,
            rotations,
            centres,
            shifts.astype(np.float32),
            self._table.numbers(shapes),
            (centres - reach).astype(np.float32),
            (centres + reach).astype(np.float32),
            side.astype(np.float32),
        )

    def render(self, intrinsics: Intrinsics, camera_to_world: np.ndarray, *, moving: Sequence[Shape] = ()) -> Frame:
        """Draw a frame; see `Renderer.render`.

        Raises:
            ValueError: the pose is not a rigid transform.
            SpecError: a moving shape's kind or surface is unknown.
        """
        pose = check_pose(camera_to_world)
        solids = self._static.joined(self._prepare(moving, fixed=False)) if moving else self._static
        m, o = visibility.to_camera(solids.rotations, solids.centres, pose)
        shape = (intrinsics.height, intrinsics.width)
        depth, ids, rgb = np.empty(shape, np.float32), np.empty(shape, np.int32), np.empty((*shape, 3), np.uint8)
        rx, ry = _ray_slopes(intrinsics)
        rotations, centres = solids.rotations.reshape(-1, 9).astype(np.float32), solids.centres.astype(np.float32)
        rows_of_pose = pose[:3].astype(np.float32).ravel()
        near, far = np.float32(NEAR_M), np.float32(FAR_M)
        pixel_slope = np.float32(1.0 / np.sqrt(intrinsics.fx * intrinsics.fy))
        looks = self._table.arrays()

        def draw(rows: np.ndarray) -> None:
            visibility.trace_rows(
                rows, rx, ry, solids.kinds, solids.sizes, solids.bounds, m, o, near, far, depth, ids
            )  # fmt: skip
            shading.shade_rows(
                rows, rx, ry, solids.kinds, solids.sizes, m, o, rotations, centres, solids.shifts, solids.looks,
                solids.low, solids.high, solids.side, looks.texels, looks.base, looks.values,
                self._light, self._side, rows_of_pose, pixel_slope, depth, ids, rgb,
            )  # fmt: skip

        run_rows(draw, -(-intrinsics.height // visibility.TILE), self._threads)
        return Frame(rgb, depth, ids)

    def close(self) -> None:
        """Nothing to release."""


def _ray_slopes(intrinsics: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """x / z of each column's rays (W,), and y / z of each row's (H,), float32."""
    rx = (np.arange(intrinsics.width) + 0.5 - intrinsics.cx) / intrinsics.fx
    ry = (np.arange(intrinsics.height) + 0.5 - intrinsics.cy) / intrinsics.fy
    return rx.astype(np.float32), ry.astype(np.float32)
