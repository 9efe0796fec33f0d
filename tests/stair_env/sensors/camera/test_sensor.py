import dataclasses
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stair_env.common.transforms import look_along, look_at
from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.colour_error import ColourErrorConfig
from stair_env.sensors.camera.depth_error import DepthErrorConfig
from stair_env.sensors.camera.renderers import threads
from stair_env.sensors.camera.renderers.base import Frame
from stair_env.sensors.camera.renderers.factory import make_renderer
from stair_env.sensors.camera.sensor import CameraConfig, RgbdCamera, draw_mount_error
from stair_env.stairs import StairSpec

CONTROL_DT = 5 / 240


class FloorRenderer:
    """Draws a chequered floor z = 0, exactly; remembers when and with what it was asked."""

    def __init__(self):
        self.poses, self.moving = [], []

    def render(self, intrinsics, camera_to_world, *, moving=()):
        self.poses.append(np.array(camera_to_world))
        self.moving.append(tuple(moving))
        directions = intrinsics.rays() @ camera_to_world[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = -camera_to_world[2, 3] / directions[..., 2]
        depth = np.where(np.isfinite(depth) & (depth > 0) & (depth < 60), depth, 0.0)
        points = camera_to_world[:3, 3] + directions * depth[..., None]
        bright = (np.floor(points[..., 0] * 20) + np.floor(points[..., 1] * 20)) % 2
        rgb = np.where(bright[..., None] > 0, 180, 90) * (depth[..., None] > 0)
        return Frame(np.broadcast_to(rgb, (*depth.shape, 3)).astype(np.uint8), depth.astype(np.float32), np.zeros(0))

    def close(self):
        pass


def pose_at(x=0.0, height=0.6, pitch_down=0.5):
    """Camera that looks along world x and down."""
    return look_along(np.array([x, 0.0, height]), 0.0, pitch_down, 0.0)


def camera(seed=0, **options):
    config = CameraConfig.from_dict({"preset": "ideal", "width": 64, **options})
    renderer = FloorRenderer()
    return RgbdCamera(config, renderer, np.random.default_rng(seed)), renderer


def run(sensor, seconds, dt=CONTROL_DT, start=0.0):
    times = start + dt * np.arange(round(seconds / dt) + 1)
    return times, [sensor.step(time, pose_at(0.1 * time)) for time in times]


# --- rate and latency ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", [5.0, 15.0, 24.0, 48.0])
@pytest.mark.parametrize("start", [0.0, 1234.5])
def test_frames_come_at_the_rate(rate_hz, start):
    sensor, renderer = camera(rate_hz=rate_hz)
    run(sensor, 4.0, start=start)
    assert len(renderer.poses) == pytest.approx(4.0 * rate_hz + 1, abs=1)


def test_captures_stay_on_the_grid():
    sensor, _ = camera(rate_hz=15.0)
    _, readings = run(sensor, 10.0)
    captured = np.unique([reading.captured_at_s for reading in readings])
    late = captured * 15.0 - np.floor(captured * 15.0 + 1e-4)
    assert late.max() / 15.0 < CONTROL_DT, "no frame waits longer than a control step, and nothing adds up"


def test_a_rate_above_the_step_rate_gives_one_frame_per_step():
    sensor, renderer = camera(rate_hz=90.0)
    _, readings = run(sensor, 1.0)
    assert len(renderer.poses) == len(readings) == len({reading.frame_index for reading in readings})


@pytest.mark.parametrize("latency_s", [0.0, 0.05, 0.1, 0.3])
def test_frames_arrive_after_the_latency_and_never_sooner(latency_s):
    sensor, _ = camera(latency_s=latency_s)
    times, readings = run(sensor, 3.0)
    for time, reading in zip(times[1:], readings[1:]):
        if reading.frame_index > 0:
            age = time - reading.captured_at_s
            assert latency_s - 1e-6 <= age <= latency_s + 1 / 15 + 2 * CONTROL_DT
    arrivals = [time for before, after, time in zip(readings, readings[1:], times[1:]) if after is not before]
    assert len(arrivals) > 25
    assert latency_s + 1 / 15 - 1e-6 <= arrivals[0] <= latency_s + 1 / 15 + 2 * CONTROL_DT


def test_latency_jitter_keeps_frames_in_order():
    sensor, _ = camera(latency_s=0.1, latency_jitter_s=0.1, rate_hz=30.0)
    times, readings = run(sensor, 5.0)
    indices = [reading.frame_index for reading in readings]
    assert indices == sorted(indices)
    ages = [time - reading.captured_at_s for time, reading in zip(times, readings) if reading.frame_index > 0]
    assert min(ages) < 0.08 and max(ages) > 0.15


def test_the_first_frame_is_there_at_once_and_after_every_reset():
    sensor, _ = camera(latency_s=0.2)
    for _ in range(2):
        reading = sensor.step(3.0, pose_at())
        assert reading.frame_index == 0 and reading.captured_at_s == 3.0
        run(sensor, 1.0, start=3.0 + CONTROL_DT)
        sensor.reset(np.random.default_rng(1))


def test_a_delivered_frame_shows_the_past():
    sensor, _ = camera(latency_s=0.2, rate_hz=48.0, near_m=0.0)
    for index in range(40):
        pose = pose_at(height=0.5 + 0.01 * index)
        reading = sensor.step(index * CONTROL_DT, pose)
        expected = FloorRenderer().render(sensor.intrinsics, pose_at(height=0.5 + 0.01 * reading.frame_index))
        np.testing.assert_array_equal(reading.depth_m, np.where(expected.depth_m <= 20.0, expected.depth_m, 0.0))


def test_moving_shapes_are_asked_for_only_when_a_frame_is_captured():
    calls = []
    sensor, renderer = camera(rate_hz=10.0)

    def shapes():
        calls.append(1)
        return ("leg",)

    for index in range(49):
        sensor.step(index * CONTROL_DT, pose_at(), shapes)
    assert len(calls) == len(renderer.poses) == 11
    assert set(renderer.moving) == {("leg",)}
    sensor.reset(np.random.default_rng(0))
    sensor.step(0.0, pose_at(), ["body", "leg"])
    assert renderer.moving[-1] == ("body", "leg")


def test_a_new_scene_comes_with_reset():
    sensor, old = camera()
    new = FloorRenderer()
    sensor.step(0.0, pose_at())
    sensor.reset(np.random.default_rng(0), new)
    sensor.step(0.0, pose_at())
    assert len(old.poses) == len(new.poses) == 1


def test_time_must_not_run_backwards_and_poses_must_be_poses():
    sensor, _ = camera()
    sensor.step(1.0, pose_at())
    sensor.step(1.0, pose_at())
    with pytest.raises(ValueError, match="time_s"):
        sensor.step(0.9, pose_at())
    with pytest.raises(ValueError, match="time_s"):
        sensor.step(float("nan"), pose_at())
    with pytest.raises(ValueError, match="camera_to_world"):
        sensor.step(2.0, np.eye(3))


# --- corruption ------------------------------------------------------------------------------------------------------


def test_an_ideal_camera_delivers_what_is_there_within_its_range():
    sensor, renderer = camera(near_m=0.7, far_m=1.5)
    exact = renderer.render(sensor.intrinsics, pose_at())
    reading = sensor.step(0.0, pose_at())
    seen = (exact.depth_m >= 0.7) & (exact.depth_m <= 1.5)
    assert 0 < seen.sum() < seen.size
    np.testing.assert_array_equal(reading.depth_m, np.where(seen, exact.depth_m, 0.0))
    np.testing.assert_array_equal(reading.rgb, exact.rgb)


def test_a_d435i_corrupts_both_images():
    sensor, renderer = camera(preset="d435i", width=None)
    exact = renderer.render(sensor.intrinsics, pose_at())
    reading = sensor.step(0.0, pose_at())
    assert reading.rgb.shape == (480, 640, 3) and reading.depth_m.shape == (480, 640)
    assert reading.rgb.dtype == np.uint8 and reading.depth_m.dtype == np.float32
    assert not np.array_equal(reading.rgb, exact.rgb)
    both = (reading.depth_m > 0) & (exact.depth_m > 0)
    error = (reading.depth_m - exact.depth_m)[both]
    assert both.mean() > 0.6 and 0.0 < np.median(np.abs(error)) < 0.02


@pytest.mark.parametrize("direction", ["up", "down"])
def test_stairs_keep_most_of_their_depth_and_lose_some(direction):
    stairs = StairSpec(direction=direction, num_steps=5)
    scene = Scene(SceneSpec(stairs))
    renderer = make_renderer("raycast", scene, threads=1)
    height = float(stairs.profile().height_at(-1.0)) + 0.55
    pose = look_at((-0.7, 0.3, height), (0.6, 0.0, height - 0.5))
    sensor = RgbdCamera(CameraConfig(), renderer, np.random.default_rng(0))
    reading, exact = sensor.step(0.0, pose), renderer.render(sensor.intrinsics, pose)
    near = (exact.depth_m > 0.2) & (exact.depth_m < 3.0)
    kept = near & (reading.depth_m > 0.0)
    error = np.abs(reading.depth_m - exact.depth_m)[kept] / exact.depth_m[kept] ** 2
    assert 0.85 < kept.sum() / near.sum() < 1.0
    assert np.percentile(error, 75) < 0.01 < np.percentile(error, 99.95), "a plane's noise and flying pixels"


def test_a_seed_decides_everything():
    def record(seed, start):
        sensor, _ = camera(seed, preset="d435i", mount_rotation_range_rad=0.05, latency_jitter_s=0.02)
        _, readings = run(sensor, 0.5, start=start)
        return [(reading.rgb, reading.depth_m, reading.frame_index) for reading in readings]

    for first, second in zip(record(3, 0.0), record(3, 0.0)):
        assert all(np.array_equal(a, b) for a, b in zip(first, second))
    assert not np.array_equal(record(3, 0.0)[0][1], record(4, 0.0)[0][1])


def test_reset_takes_one_number_however_many_frames_follow():
    states = []
    for seconds in (0.1, 1.0):
        rng = np.random.default_rng(0)
        sensor = RgbdCamera(CameraConfig(width=64), FloorRenderer(), rng)
        run(sensor, seconds)
        states.append(rng.bit_generator.state)
    assert states[0] == states[1]


# --- mount -----------------------------------------------------------------------------------------------------------


def test_mount_error_moves_the_true_camera_in_its_own_axes():
    sensor, renderer = camera(mount_offset_m=[0.0, 0.0, 0.1], mount_rotation_rad=[0.1, 0.0, 0.0])
    sensor.step(0.0, pose_at(pitch_down=0.5))
    true = renderer.poses[-1]
    np.testing.assert_allclose(true[:3, 3], pose_at()[:3, 3] + 0.1 * pose_at()[:3, 2], atol=1e-12)
    np.testing.assert_allclose(true[:3, :3], pose_at(pitch_down=0.4)[:3, :3], atol=1e-12)


def test_drawn_mount_errors_stay_in_range_and_are_rigid():
    config = CameraConfig(mount_offset_range_m=0.02, mount_rotation_range_rad=0.05)
    rng = np.random.default_rng(0)
    errors = np.array([draw_mount_error(config, rng) for _ in range(300)])
    assert 0.018 < np.abs(errors[:, :3, 3]).max() <= 0.02
    vectors = Rotation.from_matrix(errors[:, :3, :3]).as_rotvec()
    assert 0.045 < np.abs(vectors).max() <= 0.05 + 1e-12
    np.testing.assert_array_equal(draw_mount_error(CameraConfig(), rng), np.eye(4))


# --- motion blur -----------------------------------------------------------------------------------------------------


def test_a_turning_camera_blurs_and_a_standing_one_does_not():
    def contrast(turn_rad_s):
        sensor, _ = camera(
            rate_hz=48.0, width=None, colour_error={**ColourErrorConfig.ideal().to_dict(), "motion_blur": True}
        )
        for index in range(2):
            pose = pose_at()
            turn = Rotation.from_rotvec([0.0, turn_rad_s * index * CONTROL_DT, 0.0])
            pose[:3, :3] = pose[:3, :3] @ turn.as_matrix()
            reading = sensor.step(index * CONTROL_DT, pose)
        return np.abs(np.diff(reading.rgb[300:, :, 0].astype(int), axis=1)).max()

    assert contrast(0.0) == 90
    assert contrast(2.0) < 60


# --- configuration ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "values",
    [
        None,
        {},
        "ideal",
        "d435i",
        {"preset": "ideal", "rate_hz": 30},
        {"depth_error": "ideal", "colour_error": {"read_noise": 2.0}},
        {"mode": "1280x720", "width": 512, "mount_offset_m": [0.01, 0, 0]},
    ],
)
def test_config_round_trips_through_json(values):
    config = CameraConfig.from_dict(values)
    assert CameraConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_presets_differ_in_errors_and_latency():
    ideal, real = CameraConfig.from_dict("ideal"), CameraConfig.from_dict("d435i")
    assert ideal.depth_error == DepthErrorConfig.ideal() and ideal.latency_s == 0.0
    assert real == CameraConfig() and real.depth_error == DepthErrorConfig()
    assert CameraConfig.from_dict({"depth_error": "ideal"}).colour_error == ColourErrorConfig()


@pytest.mark.parametrize(("mode", "size"), [("640x480", (512, 384)), ("848x480", (512, 290)), ("1280x720", (512, 288))])
def test_width_scales_the_image_and_keeps_the_view(mode, size):
    full, scaled = D435I_COLOR_MODES[mode], CameraConfig(mode=mode, width=512).intrinsics
    assert (scaled.width, scaled.height) == size
    assert scaled.horizontal_fov_rad == pytest.approx(full.horizontal_fov_rad)
    assert scaled.vertical_fov_rad == pytest.approx(full.vertical_fov_rad)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mode": "640x400"}, "mode='640x400' must be one of '640x480'"),
        ({"renderer": "povray"}, "renderer='povray' must be one of 'raycast'"),
        ({"rate_hz": 0}, "rate_hz=0"),
        ({"latency_s": -0.1}, "latency_s=-0.1"),
        ({"latency_s": 0.01, "latency_jitter_s": 0.02}, "latency_jitter_s"),
        ({"width": 5}, "width=5"),
        ({"width": 1000}, "width=1000"),
        ({"width": 100.5}, "width=100.5"),
        ({"near_m": 3.0, "far_m": 2.0}, "near_m=3.0"),
        ({"mount_offset_m": [1.0]}, "mount_offset_m"),
        ({"mount_rotation_rad": [0, 0, "x"]}, "mount_rotation_rad"),
        ({"depth_error": "kinect"}, "depth_error='kinect' must be one of 'd435i', 'ideal'"),
        ({"depth_error": {"noise": 1}}, "depth_error field='noise'"),
        ({"colour_error": 3}, "colour_error=3"),
        ({"preset": "l515"}, "camera='l515'"),
        ({"fps": 30}, "camera field='fps'"),
        ("zed", "camera='zed'"),
        (7, "camera=7"),
    ],
)
def test_wrong_config_names_field_value_and_choices(values, message):
    with pytest.raises(ValueError, match=message):
        CameraConfig.from_dict(values)


def test_error_configs_must_be_configs():
    with pytest.raises(ValueError, match="depth_error"):
        CameraConfig(depth_error="ideal")
    with pytest.raises(ValueError, match="colour_error"):
        dataclasses.replace(CameraConfig(), colour_error=None)


def test_threads_do_not_change_the_frames(monkeypatch):
    readings = []
    for count in (1, 2):
        monkeypatch.setattr(threads, "default_threads", lambda count=count: count)
        sensor = RgbdCamera(CameraConfig(latency_s=0.0, width=128), FloorRenderer(), np.random.default_rng(5))
        readings.append([sensor.step(time_s, pose_at(time_s)) for time_s in (0.0, 0.1, 0.2)])
    for one, two in zip(*readings):
        np.testing.assert_array_equal(one.rgb, two.rgb)
        np.testing.assert_array_equal(one.depth_m, two.depth_m)


def test_depth_flickers_less_before_a_standing_camera():
    def change(speed_m_s):
        sensor, _ = camera(width=None, latency_s=0.0, rate_hz=48.0, depth_error={"structured_px": 0.0})
        frames = [sensor.step(index * CONTROL_DT, pose_at(speed_m_s * index * CONTROL_DT)) for index in range(2)]
        (first, second), exact = frames, FloorRenderer()
        poses = [pose_at(speed_m_s * index * CONTROL_DT) for index in range(2)]
        errors = [
            1.0 / np.maximum(reading.depth_m, 0.05)
            - 1.0 / np.maximum(exact.render(sensor.intrinsics, pose).depth_m, 0.05)
            for reading, pose in zip((first, second), poses)
        ]
        both = (first.depth_m > 0.0) & (second.depth_m > 0.0) & (np.abs(errors[0]) < 0.05) & (np.abs(errors[1]) < 0.05)
        return (errors[1] - errors[0])[both].std()

    assert change(0.0) < 0.85 * change(0.5)
