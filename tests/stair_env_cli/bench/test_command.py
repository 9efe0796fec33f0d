"""What `stair-env bench` compares is the same work."""

from __future__ import annotations

import numpy as np
import pybullet
import pytest

from stair_env.env import StairClimbEnv
from stair_env_cli.bench import command, env_rows, perception_rows


def test_names_are_the_rows() -> None:
    assert tuple(command.all_rows()) == command.NAMES


def test_replayed_calls_lead_to_the_same_place() -> None:
    env = StairClimbEnv()
    env.reset(seed=0)
    assert env._sim is not None
    recorder = env_rows.RecordingClient(env._sim.client)
    env._sim.client = recorder
    env.reset(seed=0)
    for _ in range(10):
        env.step(np.zeros(env.action_space.shape or (), np.float32))
    expected = recorder._wrapped.getBasePositionAndOrientation(env._sim.body)
    bare = pybullet.connect(pybullet.DIRECT)
    try:
        for function, args, kwargs in env_rows._bind(recorder.calls, bare):
            function(*args, **kwargs)
        assert pybullet.getBasePositionAndOrientation(env._sim.body, physicsClientId=bare) == expected
    finally:
        pybullet.disconnect(bare)
        env.close()


@pytest.mark.parametrize("eye", [(-0.9, 0.0, 0.5), (0.3, -0.4, 1.0)])
def test_both_cameras_look_the_same_way(eye: tuple[float, float, float]) -> None:
    from stair_env.common.transforms import look_at

    pose = look_at(eye, (0.5, 0.0, 0.3))
    ours = env_rows._opengl_view(pose)
    assert ours == pytest.approx(pybullet.computeViewMatrix(eye, (0.5, 0.0, 0.3), (0, 0, 1)), abs=1e-6)


def test_worker_memory_is_measured_in_a_fresh_process() -> None:
    assert 10.0 < env_rows._memory_mb("kept = b'x'") < env_rows._memory_mb("kept = b'x' * 50_000_000")


def test_naive_lines_are_the_true_ones() -> None:
    from perception.data.label_grid import encode_grid

    true = np.array([[20.0, 100.0, 490.0, 120.0], [10.0, 200.0, 500.0, 200.0], [40.0, 330.0, 470.0, 300.0]])
    grid = encode_grid(true)
    found = perception_rows.naive_lines(grid.cls, grid.loc)
    assert len(found) == 3
    assert np.abs(found[np.argsort(found[:, 1]), :4] - true).max() < 1.0


def test_tiny_picture_measures_metres() -> None:
    from stair_env.common.transforms import look_at
    from stair_env.intrinsics import Intrinsics
    from stair_env.scene.shapes import Shape

    client = pybullet.connect(pybullet.DIRECT)
    try:
        env_rows.add_visuals(client, [Shape("box", (2.5, 0.0, 1.0), (0.5, 3.0, 3.0))])
        rgb, depth = env_rows.tiny_picture(client, look_at((0, 0, 1), (1, 0, 1)), Intrinsics(64, 48, 50, 50, 32, 24))
    finally:
        pybullet.disconnect(client)
    assert rgb.shape == (48, 64, 3) and depth[24, 32] == pytest.approx(2.0, abs=0.01)
