import dataclasses
import functools

import cv2
import numpy as np
import pytest

from stair_env.intrinsics import D435I_COLOR_MODES, D435I_COLOUR_OFFSET_M, D435I_DEPTH_MODES, Intrinsics
from stair_env.sensors.camera.renderers.base import Frame
from stair_env.sensors.camera.sensor import CameraConfig, RgbdCamera
from stair_env.sensors.camera.stereo import StereoConfig, StereoDepth

COLOUR = D435I_COLOR_MODES["640x480"]
POSE = np.eye(4)
FLAWLESS = {  # no error but what matching makes
    "ambient_gain": (1.0, 1.0),
    "read_noise": 0.0,
    "shot_noise": 0.0,
    "speckle": 0.0,
    "vignetting": 0.0,
    "fixed_pattern": 0.0,
    "rectification_error_px": 0.0,
    "disparity_error_px": 0.0,
}


class WallRenderer:
    """A wall that faces the camera, perhaps with a box before it; world axes are the camera's (z forward)."""

    def __init__(self, wall_m, box_m=None, box_sides_m=(-0.1, 0.2), textured=True, brightness=120):
        self.wall_m, self.box_m, self.box_sides_m = wall_m, box_m, box_sides_m
        self.textured, self.brightness = textured, brightness
        self.noise = np.random.default_rng(1).uniform(-1.0, 1.0, (1000, 1000)).astype(np.float32)

    def render(self, intrinsics, camera_to_world, *, moving=()):
        shape = (intrinsics.height, intrinsics.width)
        depth = np.full(shape, self.wall_m - camera_to_world[2, 3])
        rays = np.broadcast_to(intrinsics.rays(), (*shape, 3))
        if self.box_m is not None:
            near = self.box_m - camera_to_world[2, 3]
            x = rays[..., 0] * near + camera_to_world[0, 3]
            depth = np.where((x >= self.box_sides_m[0]) & (x < self.box_sides_m[1]), near, depth)
        level = np.full(shape, float(self.brightness))
        if self.textured:  # smooth, since edges that jump by whole pixels hold no fractions of them
            x, y = (rays[..., axis] * depth + camera_to_world[axis, 3] for axis in (0, 1))
            places = [(part / 0.01 + 500.0).astype(np.float32) for part in (x, y)]
            level = level + 80.0 * cv2.remap(self.noise, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        rgb = np.repeat(level[..., None], 3, axis=2).astype(np.uint8)
        return Frame(rgb, depth.astype(np.float32), np.zeros(0))

    def close(self):
        pass


def measure(renderer, seed=0, intrinsics=COLOUR, **changes):
    sensor = StereoDepth(StereoConfig(**changes))
    rng = np.random.default_rng(seed)
    sensor.reset(rng)
    return sensor.measure(renderer, POSE, intrinsics, rng)


def lost(depth_m, margin=20):
    return float(np.mean(depth_m[margin:-margin, margin:-margin] == 0.0))


# --- how well it measures --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", sorted(D435I_DEPTH_MODES))
@pytest.mark.parametrize("wall_m", [0.8, 1.5])
def test_depth_of_a_textured_wall_is_off_by_less_than_a_tenth_of_a_pixel(mode, wall_m):
    k = D435I_DEPTH_MODES[mode]
    out = measure(WallRenderer(wall_m), mode=mode, **FLAWLESS)
    error_px = k.fx * 0.05 * (1.0 / out[out > 0.0] - 1.0 / wall_m)
    assert lost(out) < 0.1
    assert np.sqrt(np.mean(np.clip(error_px, -1, 1) ** 2)) < 0.1 and abs(np.median(error_px)) < 0.09


def test_depth_error_grows_with_the_square_of_the_distance():
    spread = []
    for wall_m in (0.7, 1.4):
        out = measure(WallRenderer(wall_m))
        spread.append(np.percentile(np.abs(out[out > 0.0] - wall_m), 68))
    assert 2.0 < spread[1] / spread[0] < 8.0


def test_readings_are_whole_millimetres_within_the_range():
    out = measure(WallRenderer(1.0, box_m=0.6), min_range_m=0.7)
    np.testing.assert_allclose(out * 1000.0, np.rint(out * 1000.0), atol=2e-3)
    assert ((out == 0.0) | (out >= 0.7)).all() and (out > 0.0).any()


@pytest.mark.parametrize("decimation", [1, 2])
def test_depth_lies_where_colour_sees_it(decimation):
    sides = (-0.15, 0.18)
    out = measure(WallRenderer(1.6, box_m=0.8, box_sides_m=sides), decimation=decimation, **FLAWLESS)
    columns = np.flatnonzero(np.median(np.abs(out[200:280] - 0.8), axis=0) < 0.05)
    expected = [COLOUR.fx * side / 0.8 + COLOUR.cx for side in sides]
    window_px = 10 * COLOUR.fx / 447.0 * 1.5  # a near side grows by up to half a window
    assert abs(columns.min() - expected[0]) < window_px and abs(columns.max() - expected[1]) < window_px


# --- where it does not -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("mode", "wall_m"), [("848x480", 0.5), ("848x480", 1.0), ("640x480", 0.6)])
def test_the_left_band_without_depth_is_as_wide_as_the_disparity(mode, wall_m):
    k = D435I_DEPTH_MODES[mode]
    # Aligned to a camera that sees all that the left imager sees, from the colour camera's place.
    seen = measure(WallRenderer(wall_m), mode=mode, intrinsics=k, **FLAWLESS)[20:-20] > 0
    band = np.mean(np.cumsum(seen, axis=1) == 0)
    expected = (k.fx * (0.05 + D435I_COLOUR_OFFSET_M) / wall_m) / k.width
    assert band == pytest.approx(expected, abs=12.0 / k.width)


@pytest.mark.parametrize("matcher", ["bm", "sgbm"])
def test_a_plain_wall_needs_the_projector(matcher):
    plain = WallRenderer(1.2, textured=False)
    assert lost(measure(plain, projector_power=0.0, matcher=matcher, texture_threshold=1.5, **FLAWLESS)) > 0.99
    assert lost(measure(plain, projector_power=2.0, matcher=matcher, dots=40_000)) < 0.4


def test_sunlight_washes_the_pattern_out_and_lamps_do_not():
    plain = WallRenderer(1.5, textured=False, brightness=180)
    lamps, sun = (measure(plain, ambient_gain=(gain, gain), dots=40_000) for gain in (0.3, 30.0))
    assert lost(lamps) < 0.3 < 0.7 < lost(sun)


def test_what_the_right_imager_does_not_see_has_no_depth_and_lies_left_of_the_near_side():
    near_m, far_m, sides = 0.7, 1.6, (-0.1, 0.3)
    out = measure(WallRenderer(far_m, near_m, sides), matcher="sgbm", block_px=5, **FLAWLESS)
    edge = round(COLOUR.fx * sides[0] / near_m + COLOUR.cx)
    other = round(COLOUR.fx * sides[1] / near_m + COLOUR.cx)
    shadow = COLOUR.fx * (0.05 + D435I_COLOUR_OFFSET_M) * (1.0 / near_m - 1.0 / far_m)
    hidden = np.mean(out[100:380] == 0.0, axis=0)
    assert hidden[round(edge - 0.7 * shadow) : edge - 8].mean() > 0.8
    assert hidden[edge - round(2.5 * shadow) : edge - round(1.5 * shadow)].mean() < 0.1
    assert hidden[other + 15 : other + 60].mean() < 0.1


def test_repeated_stripes_are_taken_for_each_other_or_lost():
    class Stripes(WallRenderer):
        def render(self, intrinsics, camera_to_world, *, moving=()):
            frame = super().render(intrinsics, camera_to_world)
            x = intrinsics.rays()[..., 0] * self.wall_m + camera_to_world[0, 3]
            rgb = np.where(np.mod(x, 0.02) < 0.01, 60, 200)[..., None].repeat(3, axis=-1)
            return dataclasses.replace(frame, rgb=np.broadcast_to(rgb, frame.rgb.shape).astype(np.uint8))

    out = measure(Stripes(1.0), projector_power=0.0, **FLAWLESS)
    assert np.mean(np.abs(out - 1.0) < 0.05) < 0.5


# --- reproducibility -------------------------------------------------------------------------------------------------


def test_a_seed_decides_the_frame_and_the_unit():
    wall = WallRenderer(1.0)
    np.testing.assert_array_equal(measure(wall, seed=3), measure(wall, seed=3))
    assert not np.array_equal(measure(wall, seed=3), measure(wall, seed=4))
    sensor = StereoDepth()
    frames = [sensor.measure(wall, POSE, COLOUR, np.random.default_rng(0)) for _ in range(2)]
    np.testing.assert_array_equal(*frames)
    sensor.reset(np.random.default_rng(9))
    assert not np.array_equal(sensor.measure(wall, POSE, COLOUR, np.random.default_rng(0)), frames[0])


def test_a_frame_takes_the_same_random_numbers_whatever_is_seen():
    states = []
    for wall_m in (0.8, 2.0):
        rng = np.random.default_rng(0)
        StereoDepth().measure(WallRenderer(wall_m), POSE, COLOUR, rng)
        states.append(rng.bit_generator.state)
    assert states[0] == states[1]


def test_the_temporal_filter_holds_a_standing_camera_still():
    def flicker(**changes):
        sensor, rng = StereoDepth(StereoConfig(read_noise=0.01, **changes)), np.random.default_rng(0)
        frames = [sensor.measure(WallRenderer(1.5), POSE, COLOUR, rng) for _ in range(6)]
        both = (frames[-1] > 0) & (frames[-2] > 0)
        return np.mean(np.minimum(np.abs(frames[-1] - frames[-2])[both], 0.05)), frames

    (plain, _), (filtered, frames) = flicker(), flicker(temporal_alpha=0.2, persistency=8)
    assert filtered < 0.6 * plain
    assert ((frames[-1] == 0.0) & (frames[-2] > 0.0)).mean() < 0.002, "a persistent reading does not vanish"


def test_the_camera_delivers_matched_depth():
    config = CameraConfig.from_dict({"preset": "ideal", "depth": "stereo", "stereo": FLAWLESS})
    reading = RgbdCamera(config, WallRenderer(1.0), np.random.default_rng(0)).step(0.0, POSE)
    assert reading.depth_m.shape == reading.rgb.shape[:2] and reading.depth_m.dtype == np.float32
    assert np.median(reading.depth_m[reading.depth_m > 0.0]) == pytest.approx(1.0, abs=0.01)


@functools.cache
def _scene():
    return WallRenderer(1.4, 0.8)


@pytest.mark.parametrize("seed", range(6))
def test_any_random_camera_delivers_finite_depth(seed):
    rng = np.random.default_rng(seed)
    sensor = StereoDepth(StereoConfig.random(rng))
    sensor.reset(rng)
    small = Intrinsics(320, 240, 300.0, 300.0, 160.0, 120.0)
    out = sensor.measure(_scene(), POSE, small, rng)
    assert out.shape == (240, 320) and np.isfinite(out).all() and (out >= 0.0).all()
    assert out.max() <= sensor.config.max_range_m
