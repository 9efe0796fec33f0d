import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

from stair_env.physics.simulation import base_to_world
from stair_env.rgbd import StairClimbRgbdEnv
from stair_env.robots import ROBOTS, mount_to_base

RGBD = "stair_env/StairClimbRGBD-v0"
SMALL = {"width": 160}


def step_some(env, count):
    for _ in range(count):
        observation, _, _, _, info = env.step(np.zeros(16))
    return observation, info


def test_checkers_are_clean():
    check_env(gym.make(RGBD, camera=SMALL).unwrapped, skip_render_check=True)
    check_env_for_sb3(gym.make(RGBD, camera=SMALL).unwrapped, skip_render_check=True)


def test_frames_come_at_their_rate_and_late():
    env = StairClimbRgbdEnv(camera={**SMALL, "rate_hz": 12.0, "latency_s": 0.1, "latency_jitter_s": 0.0})
    _, info = env.reset(seed=0)
    seen, ages = [info["camera"]["frame"]], []
    for _ in range(48):
        _, info = step_some(env, 1)
        seen.append(info["camera"]["frame"])
        ages.append(info["camera"]["time_s"] - info["camera"]["captured_at_s"])
    env.close()
    assert sorted(set(seen)) == list(range(max(seen) + 1)) and 9 <= max(seen) <= 12
    assert min(ages[10:]) >= 0.1 - 1e-9 and max(ages) < 0.1 + 2 / 12


def test_depth_is_the_distance_to_the_stairs():
    """The middle column of ideal depth, taken back into the world, lies on the treads and risers of the spec."""
    env = StairClimbRgbdEnv(camera={**SMALL, "depth_error": "ideal"}, riser_height=0.15, tread_depth=0.3)
    observation, _ = env.reset(seed=2)
    pose = base_to_world(env.state.after) @ mount_to_base(env.robot.camera)
    intrinsics, depth = env.camera_intrinsics, observation["depth"]
    column = intrinsics.width // 2
    rows = np.flatnonzero((depth[:, column] > 0) & (depth[:, column] < 1.5))
    uv = np.stack([np.full(len(rows), column + 0.5), rows + 0.5], axis=1)
    points = intrinsics.deproject(uv, depth[rows, column]) @ pose[:3, :3].T + pose[:3, 3]
    profile = env.profile
    on_tread = np.abs(points[:, 2] - profile.height_at(points[:, 0]))
    on_riser = np.abs(points[:, 0, None] - profile.edge_x).min(axis=1)
    env.close()
    assert len(rows) > 30
    assert np.quantile(np.minimum(on_tread, on_riser), 0.95) < 0.02  # a row of pixels covers as much


def test_imu_at_rest_reads_gravity_in_camera_axes():
    env = StairClimbRgbdEnv(camera=SMALL)
    observation, _ = env.reset(seed=1)
    mean = observation["imu"].mean(axis=0)
    tilt = ROBOTS["aliengo"].camera.pitch_down_rad
    env.close()
    assert mean[:3] == pytest.approx([0.0, -9.81 * np.cos(tilt), -9.81 * np.sin(tilt)], abs=0.6)
    assert mean[3:] == pytest.approx(np.zeros(3), abs=0.05)


def test_same_seed_same_frames_and_same_stairs_as_without_camera():
    def frames():
        env = StairClimbRgbdEnv(camera=SMALL, lighting="random", direction="both", randomization=True)
        env.reset(seed=9)
        observation, info = step_some(env, 12)
        env.close()
        return observation, info

    (first, info), (second, _) = frames(), frames()
    for key, value in first.items():
        assert np.array_equal(value, second[key]), key
    plain = gym.make("stair_env/StairClimb-v0", direction="both", randomization=True)
    _, truth = plain.reset(seed=9)
    plain.close()
    assert truth["truth"]["riser_height"] == info["truth"]["riser_height"]


def test_night_is_darker_than_day():
    means = {}
    for lighting in ("day", "night"):
        env = StairClimbRgbdEnv(camera=SMALL, lighting=lighting)
        means[lighting] = np.mean([env.reset(seed=seed)[0]["rgb"].mean() for seed in range(3)])
        env.close()
    assert means["night"] < 0.6 * means["day"]


@pytest.mark.parametrize("camera", [{"mode": "320x200"}, {"renderer": "povray"}, {"rate": 3}, {"depth_error": "none"}])
def test_wrong_camera_options_are_named(camera):
    with pytest.raises(ValueError, match=next(iter(camera))):
        StairClimbRgbdEnv(camera=camera)


def test_tinyrenderer_sees_the_same_stairs():
    depths = []
    for renderer in ("raycast", "tiny"):
        env = StairClimbRgbdEnv(camera={**SMALL, "renderer": renderer, "depth_error": "ideal"})
        depths.append(env.reset(seed=3)[0]["depth"])
        env.close()
    both = (depths[0] > 0) & (depths[1] > 0) & (depths[0] < 2.0)
    assert both.mean() > 0.3
    assert np.median(np.abs(depths[0] - depths[1])[both]) < 0.002
