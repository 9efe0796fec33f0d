"""The sensors' default renderer: our own, compiled, exact, without PyBullet."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from stair_env.intrinsics import Intrinsics
from stair_env.scene.appearance import AppearanceSpec
from stair_env.scene.shapes import Shape
from stair_env.sensors.camera.renderers import shading, smoothing, visibility
from stair_env.sensors.camera.renderers.base import FAR_M, NEAR_M, Frame, SceneLike, check_pose
from stair_env.sensors.camera.renderers.shading_tables import Looks, LookTable, across, light_settings
from stair_env.sensors.camera.renderers.solids import Solids
from stair_env.sensors.camera.renderers.threads import run_rows


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


@dataclass(frozen=True)
class _Rays:
    """Rays in tiles; see `visibility.trace_rows`."""

    x: np.ndarray
    y: np.ndarray
    spans: np.ndarray

    @classmethod
    def of(cls, x: np.ndarray, y: np.ndarray) -> _Rays:
        """Any rays, (rows of tiles, columns of tiles, AREA) float32."""
        return cls(x, y, visibility.tile_spans(x, y))

    @classmethod
    @functools.lru_cache(maxsize=8)
    def through_centres(cls, intrinsics: Intrinsics) -> _Rays:
        """One through the centre of each pixel, and of those that fill up the last tiles."""
        tile = visibility.TILE
        rows, columns = -(-intrinsics.height // tile), -(-intrinsics.width // tile)
        u, v = (np.arange(count * tile) + 0.5 for count in (columns, rows))
        slopes = np.meshgrid((u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy)
        x, y = (
            np.ascontiguousarray(
                slope.astype(np.float32).reshape(rows, tile, columns, tile).transpose(0, 2, 1, 3)
            ).reshape(rows, columns, visibility.AREA)
            for slope in slopes
        )
        return cls.of(x, y)


@dataclass(frozen=True)
class _Scratch:
    """What a frame needs only while it is drawn.

    Attributes:
        regions: (H, W) int32, see `shading.shade_rows`.
        borders: (rows of tiles, TILE * W) int64, see `smoothing.find_borders`.
    """

    regions: np.ndarray
    borders: np.ndarray

    @classmethod
    def of(cls, height: int, width: int) -> _Scratch:
        """For images of this size, pixels."""
        tile = visibility.TILE
        return cls(np.empty((height, width), np.int32), np.empty((-(-height // tile), tile * width), np.int64))


class RaycastRenderer:
    """Casts one ray through every pixel centre.

    Args:
        scene: what stands still.
        appearance: materials and light; None for the scene's own (`scene.spec.appearance`), or the default ones.
        shadows: whether the light casts shadows, if the appearance has it so.
        textures: whether surfaces show their texture or its mean colour.
        antialias: whether outlines, creases and borders of shadows are drawn with more rays (colour only).
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
        antialias: bool = True,
        threads: int | None = None,
    ) -> None:
        if threads is not None and threads < 1:
            raise ValueError(f"threads={threads!r} must be at least 1, or None")
        self._threads = threads
        self._antialias = antialias
        if appearance is None:
            appearance = getattr(getattr(scene, "spec", None), "appearance", None) or AppearanceSpec()
        self._light = light_settings(appearance, shadows)
        self._side = across(np.array(appearance.light_direction))
        self._table = LookTable(appearance, textures)
        self._static = self._prepare(scene.shapes, fixed=True)
        self._spare: list[_Scratch] = []

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
        view = _View(solids, self._table.arrays(), self._light, self._side, intrinsics, pose)
        shape = (intrinsics.height, intrinsics.width)
        depth, ids, rgb = np.empty(shape, np.float32), np.empty(shape, np.int32), np.empty((*shape, 3), np.uint8)
        scratch = self._borrow_scratch(intrinsics)
        rays = _Rays.through_centres(intrinsics)
        tiles = -(-intrinsics.height // visibility.TILE)
        run_rows(lambda rows: view.draw(rows, rays, depth, ids, rgb, scratch.regions), tiles, self._threads)
        if self._antialias:
            regions, borders, counts = scratch.regions, scratch.borders, np.zeros(tiles, np.int64)
            run_rows(lambda rows: smoothing.find_borders(rows, regions, rgb, borders, counts), tiles, self._threads)
            pixels = np.concatenate([row[:count] for row, count in zip(borders, counts.tolist())])
            groups = -(-len(pixels) // smoothing.GROUP)
            run_rows(lambda chosen: view.smooth(pixels, chosen, rgb), groups, self._threads)
        self._spare.append(scratch)
        return Frame(rgb, depth, ids)

    def _borrow_scratch(self, intrinsics: Intrinsics) -> _Scratch:
        """Scratch for images of this size; fresh pages of memory cost as much as a kernel. Safe between threads."""
        while self._spare:
            scratch = self._spare.pop()
            if scratch.regions.shape == (intrinsics.height, intrinsics.width):
                return scratch
        return _Scratch.of(intrinsics.height, intrinsics.width)

    def close(self) -> None:
        """Nothing to release."""


class _View:
    """What the kernels need to draw solids from one place."""

    def __init__(
        self,
        solids: _Drawn,
        looks: Looks,
        light: np.ndarray,
        side: np.ndarray,
        intrinsics: Intrinsics,
        camera_to_world: np.ndarray,
    ) -> None:
        self._solids, self._looks, self._light, self._side = solids, looks, light, side
        self._m, self._o = visibility.to_camera(solids.rotations, solids.centres, camera_to_world)
        self._rotations = solids.rotations.reshape(-1, 9).astype(np.float32)
        self._centres = solids.centres.astype(np.float32)
        self._pose = camera_to_world[:3].astype(np.float32).ravel()
        self._principal = np.float32(intrinsics.cx), np.float32(intrinsics.cy)
        self._slope = np.float32(1.0 / intrinsics.fx), np.float32(1.0 / intrinsics.fy)
        self._pixel_slope = np.float32(1.0 / np.sqrt(intrinsics.fx * intrinsics.fy))

    def draw(
        self,
        rows: np.ndarray,
        rays: _Rays,
        depth: np.ndarray,
        ids: np.ndarray,
        rgb: np.ndarray,
        regions: np.ndarray,
    ) -> None:
        """Fill rows of tiles of the images; see `visibility.trace_rows` and `shading.shade_rows`."""
        solids, looks = self._solids, self._looks
        near, far = np.float32(NEAR_M), np.float32(FAR_M)
        visibility.trace_rows(
            rows, rays.x, rays.y, rays.spans, solids.kinds, solids.sizes, solids.bounds, self._m, self._o,
            near, far, depth, ids,
        )  # fmt: skip
        shading.shade_rows(
            rows, rays.x, rays.y, solids.kinds, solids.sizes, self._m, self._o, self._rotations, self._centres,
            solids.shifts, solids.looks, solids.low, solids.high, solids.side,
            looks.texels, looks.base, looks.values, self._light, self._side,
            self._pose, self._pixel_slope, depth, ids, rgb, regions,
        )  # fmt: skip

    def smooth(self, pixels: np.ndarray, groups: np.ndarray, rgb: np.ndarray) -> None:
        """Draw groups of smoothing.GROUP pixels of the image again, with more rays."""
        if len(groups) == 0:
            return
        size = smoothing.GROUP  # whole packets, so that a packet holds the same rays whoever draws it
        pixels = np.concatenate([pixels[group * size : (group + 1) * size] for group in groups.tolist()])
        packets = -(-len(pixels) * smoothing.SAMPLES // visibility.AREA)
        x, y = np.empty((2, packets, 1, visibility.AREA), np.float32)
        smoothing.spread_rays(pixels, rgb.shape[1], *self._principal, *self._slope, x.reshape(-1), y.reshape(-1))
        shape = (packets * visibility.TILE, visibility.TILE)
        depth, ids, regions = np.empty(shape, np.float32), np.empty(shape, np.int32), np.empty(shape, np.int32)
        samples = np.empty((*shape, 3), np.uint8)
        self.draw(np.arange(packets), _Rays.of(x, y), depth, ids, samples, regions)
        smoothing.average_samples(pixels, samples.reshape(-1, 3), rgb)
