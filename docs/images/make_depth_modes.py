"""Draws docs/images/depth_modes.jpg, the error model beside matched depth: `python docs/images/make_depth_modes.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from stair_env.camera.depth_error import DepthErrorModel
from stair_env.camera.intrinsics import D435I_COLOR_MODES
from stair_env.camera.labels import visible_edges
from stair_env.camera.renderers.factory import make_renderer
from stair_env.camera.stereo import StereoDepth
from stair_env.scene_spec import Scene

from stair_env.sampling import SceneSampler, sample_camera_pose

matplotlib.use("Agg")
from matplotlib import pyplot as plt

INTRINSICS = D435I_COLOR_MODES["640x480"]
FOCAL_BASELINE = 447.0 * 0.05  # pixels times metres
MODES = ("model", "stereo")
SHOWN, MEASURED = 3, 20  # views
REACH_PX = 24  # rows beside a crease
SPAN_PX = 128  # columns whose error is taken apart into wavelengths


def disparity(depth_m: np.ndarray) -> np.ndarray:
    """Pixels of the depth imager, NaN without a reading."""
    return np.where(depth_m > 0.0, FOCAL_BASELINE / np.maximum(depth_m, 0.05), np.nan)


def views(count: int):
    """Colour, exact depth, depth of each mode, and stair lines of random views."""
    rng = np.random.default_rng(12)
    for _ in range(count):
        spec = SceneSampler(lighting="day").sample(rng)
        scene = Scene(spec)
        pose = sample_camera_pose(spec, rng, scene=scene)
        renderer = make_renderer("raycast", scene)
        frame = renderer.render(INTRINSICS, pose)
        model, stereo = DepthErrorModel(), StereoDepth()
        model.reset(rng)
        stereo.reset(rng)
        depths = {
            "model": model.apply(frame.depth_m, frame.rgb, INTRINSICS, rng),
            "stereo": stereo.measure(renderer, pose, INTRINSICS, rng),
        }
        yield frame.rgb, frame.depth_m, depths, visible_edges(scene.edges, INTRINSICS, pose, frame)
        renderer.close()


def crease_rows(error_px: np.ndarray, near: np.ndarray, lines) -> list[np.ndarray]:
    """Absolute errors across stair lines, (2 REACH_PX + 1,) each."""
    found = []
    for line in lines:
        for x in np.linspace(line.x1 + 8, line.x2 - 8, 10).astype(int) if line.x2 - line.x1 > 60 else ():
            y = int(line.y1 + (line.y2 - line.y1) / (line.x2 - line.x1) * (x - line.x1))
            if 95 < x < 630 and REACH_PX < y < 479 - REACH_PX and near[y, x]:
                found.append(np.abs(error_px[y - REACH_PX : y + REACH_PX + 1, x]))
    return found


def spectra(error_px: np.ndarray) -> list[np.ndarray]:
    """Amplitudes of whole stretches of rows without holes and gross errors."""
    stretches = error_px[8:-8:8, 96 : 96 + 4 * SPAN_PX].reshape(-1, SPAN_PX)
    whole = stretches[(np.abs(stretches) < 1.5).all(axis=1)]
    smooth = whole - whole.mean(axis=1, keepdims=True)
    return list(np.abs(np.fft.rfft(smooth * np.hanning(SPAN_PX), axis=1)) / SPAN_PX)


def main() -> None:
    """Write the figure beside this file."""
    figure = plt.figure(figsize=(13, 8.2), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(2.2, 1))
    pictures = above.subplots(SHOWN, 4)
    profile: dict[str, list[np.ndarray]] = {name: [] for name in MODES}
    spectrum: dict[str, list[np.ndarray]] = {name: [] for name in MODES}
    missing: dict[str, list[float]] = {name: [] for name in MODES}
    for index, (rgb, exact_m, depths, lines) in enumerate(views(MEASURED)):
        near = (exact_m > 0.3) & (exact_m < 4.0)
        for name, depth_m in depths.items():
            error_px = np.where(near, disparity(depth_m) - disparity(exact_m), np.nan)
            profile[name] += crease_rows(error_px, near, lines)
            spectrum[name] += spectra(error_px)
            missing[name].append(float(np.mean(depth_m[near] == 0.0)) if near.any() else np.nan)
        if index >= SHOWN:
            continue
        row = pictures[index]
        row[0].imshow(rgb)
        for axis, depth_m in zip(row[1:], (exact_m, *(depths[name] for name in MODES))):
            axis.imshow(np.where(depth_m > 0.0, 1.0 / np.maximum(depth_m, 0.1), np.nan), cmap="turbo", vmin=0, vmax=2)
            axis.set_facecolor("black")
        for axis, title in zip(row, ("colour, clean", "exact depth", "error model", "matched infrared pair")):
            axis.set(title=title if index == 0 else "", xticks=[], yticks=[])
    left, right = below.subplots(1, 2)
    for name in MODES:
        offsets = np.arange(-REACH_PX, REACH_PX + 1)
        label = f"{name}, {np.nanmean(missing[name]):.0%} without reading"
        left.plot(offsets, np.nanmedian(profile[name], axis=0), label=label)
        wavelengths = SPAN_PX / np.arange(1, SPAN_PX // 2 + 1)
        right.loglog(wavelengths, np.median(spectrum[name], axis=0)[1:], label=name)
    left.set(xlabel="rows beside a stair line, px", ylabel="median error of disparity, px", ylim=(0, None))
    right.set(xlabel="wavelength of the error along a row, px", ylabel="amplitude, px")
    for axis in (left, right):
        axis.grid(alpha=0.3)
        axis.legend()
    figure.savefig(Path(__file__).with_name("depth_modes.jpg"), dpi=72, pil_kwargs={"quality": 82})


if __name__ == "__main__":
    main()
