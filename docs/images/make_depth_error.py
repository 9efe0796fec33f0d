"""Draws docs/images/depth_error.png: `python docs/images/make_depth_error.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

from stair_env.common.transforms import look_at
from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.sampling import SceneSampler
from stair_env.scene.spec import Scene
from stair_env.sensors.camera.depth_error import DepthErrorConfig, DepthErrorModel, depth_rms_m
from stair_env.sensors.camera.renderers.factory import make_renderer

matplotlib.use("Agg")
from matplotlib import pyplot as plt

INTRINSICS = D435I_COLOR_MODES["640x480"]


def simulated_rms_m(depths_m: np.ndarray) -> np.ndarray:
    """RMS error on textured planes that face the camera, metres."""
    model, rng = DepthErrorModel(), np.random.default_rng(0)
    shape = (INTRINSICS.height, INTRINSICS.width)
    rgb = rng.integers(60, 200, (*shape, 3), dtype=np.uint8)
    found = []
    for depth_m in depths_m:
        out = model.apply(np.full(shape, depth_m, np.float32), rgb, INTRINSICS, rng)
        found.append(np.sqrt(np.mean((out[out > 0.0] - depth_m) ** 2)))
    return np.array(found)


def staircase_views(
    direction: str, eye: tuple[float, float, float], target: tuple[float, float, float], seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colour image, exact depth and reported depth of a staircase."""
    rng = np.random.default_rng(seed)
    sampler = SceneSampler(0.15, 0.3, 5, direction=direction, lighting="day", distractors=False, details=False)
    renderer = make_renderer("raycast", Scene(sampler.sample(rng)))
    frame = renderer.render(INTRINSICS, look_at(eye, target))
    return frame.rgb, frame.depth_m, DepthErrorModel().apply(frame.depth_m, frame.rgb, INTRINSICS, rng)


def draw_curve(axis: plt.Axes) -> None:
    """Published and simulated error over distance."""
    grid = np.linspace(0.3, 4.0, 60)
    axis.plot(grid, 1e3 * depth_rms_m(grid, DepthErrorConfig()), label="Z² s / (f B), s = 0.08 px (Intel)")
    axis.plot(grid, 1e3 * (0.00061 + 0.00359 * (grid - 0.35) ** 2), "--", label="0.00061 + 0.00359 (Z - 0.35)² (fit)")
    axis.plot(grid[::3], 1e3 * simulated_rms_m(grid[::3]), "k.", label="simulated, all errors on")
    axis.set(xlabel="distance Z, m", ylabel="RMS depth error, mm")
    axis.grid(alpha=0.3)
    axis.legend()


def main() -> None:
    """Write the figure beside this file."""
    figure = plt.figure(figsize=(15, 5.6), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1, 2.2))
    draw_curve(left.subplots())
    axes = right.subplots(2, 3)
    views = (("up", (-0.9, 0.2, 0.55), (0.8, -0.1, 0.35), 3), ("down", (-0.45, 0.1, 1.3), (1.2, -0.1, 0.2), 8))
    for row, view in zip(axes, views):
        rgb, *depths = staircase_views(*view)
        row[0].imshow(rgb)
        for axis, depth_m in zip(row[1:], depths):
            axis.imshow(np.where(depth_m > 0.0, 1.0 / np.maximum(depth_m, 0.1), np.nan), cmap="turbo", vmin=0, vmax=1.4)
            axis.set_facecolor("black")
        for axis, title in zip(row, ("colour, clean", "exact depth", "reported depth")):
            axis.set(title=title, xticks=[], yticks=[])
    figure.savefig(Path(__file__).with_name("depth_error.png"), dpi=70)


if __name__ == "__main__":
    main()
