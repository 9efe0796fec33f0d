"""The comparisons of `stair-env bench`: ours beside the plain way to do the same."""

from __future__ import annotations

import itertools
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from stair_env.intrinsics import Intrinsics
from stair_env.scene.shapes import Shape
from stair_env_cli.bench.timing import Row, seconds_per_call, time_pair

CLIMB_ID = "stair_env/StairClimb-v0"
EPISODE_STEPS = 96  # two seconds of walking
VECTOR_ENVS = 8
VECTOR_STEPS = 48  # before the first robot is through
FRAME_SIZE = 512  # what StairNetV2 looks at
MEGABYTE = 1e6
NEAR_M, FAR_M = 0.05, 20.0  # of TinyRenderer's pictures

_OURS_IN_MEMORY = """
import gymnasium, stair_env
env = gymnasium.make("stair_env/StairClimb-v0")
env.reset(seed=0)
for _ in range(48):
    env.step(env.action_space.sample())
import sys
assert "torch" not in sys.modules and "stable_baselines3" not in sys.modules
"""
_THEIRS_IN_MEMORY = """
import numpy, gymnasium, pybullet, pybullet_data
pybullet.connect(pybullet.DIRECT)
pybullet.setAdditionalSearchPath(pybullet_data.getDataPath())
pybullet.loadURDF("aliengo/aliengo.urdf")
for _ in range(240):
    pybullet.stepSimulation()
"""
_PRINT_MEMORY = "\nimport psutil\nprint('RSS', psutil.Process().memory_info().rss)"


class RecordingClient:
    """Stands before a Bullet client and writes down every call."""

    def __init__(self, client: Any) -> None:
        self._wrapped = client
        self.calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []

    def __getattr__(self, name: str) -> Any:
        function = getattr(self._wrapped, name)
        if not callable(function):
            return function

        def call(*args: Any, **kwargs: Any) -> Any:
            self.calls.append((name, args, kwargs))
            return function(*args, **kwargs)

        return call


def env_step(rounds: int) -> Row:
    """`env.step` against a bare loop of the very same PyBullet calls."""
    import pybullet

    from stair_env.env import StairClimbEnv
    from stair_env.physics.simulation import Simulation

    env = StairClimbEnv()
    action = np.zeros(env.action_space.shape or (), np.float32)
    env.reset(seed=0)
    assert isinstance(env._sim, Simulation)
    recorder = RecordingClient(env._sim.client)
    env._sim.client = recorder
    env.reset(seed=0)
    before = list(recorder.calls)
    recorder.calls.clear()
    for _ in range(EPISODE_STEPS):
        env.step(action)
    during = list(recorder.calls)
    env._sim.client = recorder._wrapped
    bare = pybullet.connect(pybullet.DIRECT)
    prepare, replay = (_bind(calls, bare) for calls in (before, during))

    def ours() -> float:
        env.reset(seed=0)
        start = time.perf_counter()
        for _ in range(EPISODE_STEPS):
            env.step(action)
        return (time.perf_counter() - start) / EPISODE_STEPS

    def theirs() -> float:
        for function, args, kwargs in prepare:
            function(*args, **kwargs)
        start = time.perf_counter()
        for function, args, kwargs in replay:
            function(*args, **kwargs)
        return (time.perf_counter() - start) / EPISODE_STEPS

    try:
        return time_pair("env.step / the same PyBullet calls in a bare loop", ours, theirs, rounds=rounds, target=0.87)
    finally:
        env.close()
        pybullet.disconnect(bare)


def _bind(calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]], client: int) -> list[Any]:
    """Recorded calls as PyBullet's own functions with their arguments."""
    import pybullet

    pure = {"getQuaternionFromEuler", "getMatrixFromQuaternion"}  # these take no client
    return [
        (getattr(pybullet, name), args, kwargs if name in pure else {**kwargs, "physicsClientId": client})
        for name, args, kwargs in calls
    ]


def vector_step(rounds: int) -> Row:
    """One environment's share of a vector step, against a step of an environment alone."""
    import gymnasium as gym

    import stair_env  # noqa: F401  (registers the ids)

    vector, single = gym.make_vec(CLIMB_ID, num_envs=VECTOR_ENVS), gym.make(CLIMB_ID, disable_env_checker=True)
    actions = np.zeros(vector.action_space.shape or (), np.float32)

    seeds = itertools.cycle(range(VECTOR_ENVS))  # stairs differ in cost: the one alone meets them all in turn

    def ours() -> float:
        vector.reset(seed=0)
        return seconds_per_call(lambda: vector.step(actions), VECTOR_STEPS)() / VECTOR_ENVS

    def theirs() -> float:
        single.reset(seed=next(seeds))
        return seconds_per_call(lambda: single.step(actions[0]), VECTOR_STEPS)()

    try:
        name = f"env step, {VECTOR_ENVS} of a vector / one alone"
        return time_pair(name, ours, theirs, rounds=rounds, target=1.7)
    finally:
        vector.close()
        single.close()


def camera_frame(rounds: int) -> Row:
    """A D435i frame with every error, ray-cast, against a bare TinyRenderer picture of the same solids."""
    import pybullet

    from stair_env.common.transforms import look_at
    from stair_env.sampling import Scene, SceneSpec
    from stair_env.sensors.camera.renderers import make_renderer
    from stair_env.sensors.camera.sensor import CameraConfig, RgbdCamera
    from stair_env.stairs import StairSpec

    scene = Scene(SceneSpec(StairSpec(num_steps=8)))
    pose = look_at((-0.9, 0.0, 0.5), (0.5, 0.0, 0.3))
    focal = FRAME_SIZE / 2 / np.tan(np.radians(69.0 / 2))
    intrinsics = Intrinsics(FRAME_SIZE, FRAME_SIZE, focal, focal, FRAME_SIZE / 2, FRAME_SIZE / 2)
    camera = RgbdCamera(CameraConfig(latency_s=0.0), make_renderer("raycast", scene), np.random.default_rng(0))
    camera.intrinsics = intrinsics
    clock = iter(range(10**9))
    client = pybullet.connect(pybullet.DIRECT)
    add_visuals(client, scene.shapes)

    try:
        return time_pair(
            "camera frame 512x512 with all errors / bare TinyRenderer",
            seconds_per_call(lambda: camera.step(float(next(clock)), pose), 3),
            seconds_per_call(lambda: tiny_picture(client, pose, intrinsics)),
            rounds=rounds,
            target=10.0,
        )
    finally:
        pybullet.disconnect(client)


def add_visuals(client: int, shapes: Sequence[Shape]) -> None:
    """Put solids into a bare PyBullet world, to be looked at only."""
    import pybullet

    for shape in shapes:
        if shape.kind == "box":
            visual = pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=shape.size, physicsClientId=client)
        elif shape.kind == "sphere":
            visual = pybullet.createVisualShape(pybullet.GEOM_SPHERE, radius=shape.size[0], physicsClientId=client)
        else:
            kind = pybullet.GEOM_CYLINDER if shape.kind == "cylinder" else pybullet.GEOM_CAPSULE
            length = 2 * shape.size[1]
            visual = pybullet.createVisualShape(kind, radius=shape.size[0], length=length, physicsClientId=client)
        pybullet.createMultiBody(0, -1, visual, shape.position, shape.orientation, physicsClientId=client)


def tiny_picture(client: int, camera_to_world: np.ndarray, intrinsics: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """TinyRenderer's colour uint8 (H, W, 3) and depth float32 (H, W) in metres, with little around it."""
    import pybullet

    width, height = intrinsics.width, intrinsics.height
    field_of_view = float(np.degrees(2 * np.arctan(height / 2 / intrinsics.fy)))
    _, _, colour, depth, _ = pybullet.getCameraImage(
        width,
        height,
        _opengl_view(camera_to_world),
        pybullet.computeProjectionMatrixFOV(field_of_view, width / height, NEAR_M, FAR_M),
        renderer=pybullet.ER_TINY_RENDERER,
        physicsClientId=client,
    )
    metres = FAR_M * NEAR_M / (FAR_M - (FAR_M - NEAR_M) * np.asarray(depth, np.float32).reshape(height, width))
    return np.asarray(colour, np.uint8).reshape(height, width, 4)[..., :3].copy(), metres


def _opengl_view(camera_to_world: np.ndarray) -> list[float]:
    """Bullet's view matrix (column-major) of an optical pose (x right, y down, z forward)."""
    flipped = camera_to_world @ np.diag([1.0, -1.0, -1.0, 1.0])
    view: list[float] = np.linalg.inv(flipped).T.ravel().tolist()
    return view


def worker_memory(rounds: int) -> Row:
    """Resident memory of a physics worker against bare PyBullet with the same robot."""
    del rounds  # memory does not scatter
    ours, theirs = (_memory_mb(code) for code in (_OURS_IN_MEMORY, _THEIRS_IN_MEMORY))
    return Row("memory of a physics worker / bare PyBullet", ours, theirs, theirs / ours, "MB", 1)


def _memory_mb(code: str) -> float:
    done = subprocess.run([sys.executable, "-c", code + _PRINT_MEMORY], capture_output=True, text=True, check=True)
    return int(done.stdout.rsplit("RSS", 1)[1]) / MEGABYTE


ROWS: dict[str, Callable[[int], Row]] = {
    "env-step": env_step,
    "vector-step": vector_step,
    "camera-frame": camera_frame,
    "worker-memory": worker_memory,
}
