"""The fast error model against matched depth, on the same views of stairs."""

import functools

import numpy as np
import pytest

from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.sampling import SceneSampler, sample_camera_pose
from stair_env.scene.spec import Scene
from stair_env.sensors.camera.depth_error import DepthErrorConfig, DepthErrorModel
from stair_env.sensors.camera.labels import visible_edges
from stair_env.sensors.camera.renderers.factory import make_renderer
from stair_env.sensors.camera.stereo import StereoDepth

INTRINSICS = D435I_COLOR_MODES["640x480"]
FOCAL_BASELINE = 447.0 * 0.05
VIEWS = 10
# The stereo mode has no error of scale, of focal length or of place against colour: compare without.
CALIBRATED = DepthErrorConfig(scale_bias_range=0.0, focal_error_range=0.0, misalignment_px=0.0)
REACH_PX = 24


def disparity(depth_m):
    return np.where(depth_m > 0.0, FOCAL_BASELINE / np.maximum(depth_m, 0.05), np.nan)


def box_mean(values, side):
    """Mean over squares of what is not NaN."""
    height, width = (part // side * side for part in values.shape)
    cells = values[:height, :width].reshape(height // side, side, width // side, side)
    with np.errstate(invalid="ignore"):
        full = np.isfinite(cells).mean((1, 3)) > 0.8
        return np.where(full, np.nansum(cells, (1, 3)) / np.maximum(np.isfinite(cells).sum((1, 3)), 1), np.nan)


def statistics(exact_m, out_m, lines):
    """Hole share, error of planes by scale, and error by distance from a crease, all of one frame."""
    near = (exact_m > 0.3) & (exact_m < 4.0)
    exact = disparity(exact_m)
    error = np.where(near & (out_m > 0.0), disparity(out_m) - exact, np.nan)
    bend = np.full(exact.shape, np.inf)
    bend[8:-8, 8:-8] = np.maximum(
        np.abs(exact[:-16, 8:-8] + exact[16:, 8:-8] - 2 * exact[8:-8, 8:-8]),
        np.abs(exact[8:-8, :-16] + exact[8:-8, 16:] - 2 * exact[8:-8, 8:-8]),
    )
    flat = np.where((bend < 0.02) & (np.abs(error) < 1.5), error, np.nan)
    fine = box_mean(flat, 2) - np.repeat(np.repeat(box_mean(flat, 8), 4, 0), 4, 1)
    middle = box_mean(flat, 8) - np.repeat(np.repeat(box_mean(flat, 32), 4, 0), 4, 1)
    profile = []
    for line in lines:
        if line.x2 - line.x1 < 60:
            continue
        for x in np.linspace(line.x1 + 8, line.x2 - 8, 10).astype(int):
            y = int(line.y1 + (line.y2 - line.y1) / (line.x2 - line.x1) * (x - line.x1))
            if 95 < x < 630 and REACH_PX < y < 479 - REACH_PX and near[y, x]:
                profile.append(np.abs(error[y - REACH_PX : y + REACH_PX + 1, x]))
    seen = near & (np.arange(exact.shape[1]) > 90)
    hole = np.mean(out_m[seen] == 0.0) if seen.any() else np.nan
    return hole, np.nanstd(fine), np.nanstd(middle), np.nanstd(box_mean(flat, 32)), profile


@functools.cache
def both_modes():
    """Means of the statistics over the views for the model and for the matched depth."""
    rng, found = np.random.default_rng(5), {"model": [], "stereo": []}
    for _ in range(VIEWS):
        spec = SceneSampler(0.16, 0.29).sample(rng)
        scene = Scene(spec)
        pose = sample_camera_pose(spec, rng, robot_share=0.5, scene=scene)
        renderer = make_renderer("raycast", scene, threads=1)
        frame = renderer.render(INTRINSICS, pose)
        lines = visible_edges(scene.edges, INTRINSICS, pose, frame)
        model, stereo = DepthErrorModel(CALIBRATED), StereoDepth()
        model.reset(rng), stereo.reset(rng)
        depth = {
            "model": model.apply(frame.depth_m, frame.rgb, INTRINSICS, rng),
            "stereo": stereo.measure(renderer, pose, INTRINSICS, rng),
        }
        renderer.close()
        for name, out_m in depth.items():
            found[name].append(statistics(frame.depth_m, out_m, lines))
    means = {}
    for name, frames in found.items():
        numbers = np.nanmean([frame[:4] for frame in frames], axis=0)
        with np.errstate(all="ignore"):
            profile = np.nanmedian([row for frame in frames for row in frame[4]], axis=0)
        means[name] = (*numbers, profile)
    return means


def test_both_lose_a_like_share_of_the_readings():
    model, stereo = (both_modes()[name][0] for name in ("model", "stereo"))
    assert 0.04 < stereo < 0.35 and 0.4 < model / stereo < 2.5


@pytest.mark.parametrize(("scale", "index"), [("below 8 px", 1), ("8 to 32 px", 2), ("above 32 px", 3)])
def test_errors_on_planes_have_a_like_spectrum(scale, index):
    model, stereo = (both_modes()[name][index] for name in ("model", "stereo"))
    assert 0.45 < model / stereo < 2.2, scale


def test_both_round_creases_over_the_window():
    profiles = {name: both_modes()[name][4] for name in ("model", "stereo")}
    for profile in profiles.values():
        at, beside, away = profile[REACH_PX], profile[[REACH_PX - 4, REACH_PX + 4]].mean(), profile[[2, -3]].mean()
        assert at > 1.4 * away and at > beside > away
    assert profiles["model"][REACH_PX] == pytest.approx(profiles["stereo"][REACH_PX], rel=0.5)
