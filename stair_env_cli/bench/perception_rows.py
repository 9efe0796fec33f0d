"""Comparisons around StairNetV2: back ends, what comes after the network, the whole perceived frame, batches.

The networks have random weights, since time does not depend on them. What comes after the network gets the true lines
of the frame instead of its answer, so that it has the work of a good detection.
"""

from __future__ import annotations

import functools
import itertools
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stair_env_cli.bench.env_rows import add_visuals, tiny_picture
from stair_env_cli.bench.timing import Row, seconds_per_call, time_pair

CELL_WIDTH_PX, CELL_HEIGHT_PX = 32, 16
CLUSTER_PX = 8.0  # how far a segment's middle may lie from a line that it joins
MANY_ENVS = 8
TRAINED_FRAMES = 4
PERCEPTION_ID = "stair_env/StairClimbPerception-v0"
WALKED_STEPS = 24  # half a second: the robot trots and the stairs are ahead
MIN_CELLS = 40  # of a frame worth timing: a few stair lines across the picture


@dataclass(frozen=True)
class Sample:
    """A rendered frame with everything to render, perceive and interpret it again."""

    frame: Any
    scene: Any
    cls: np.ndarray
    loc: np.ndarray


@functools.cache
def sample_frame() -> Sample:
    """A day-light frame with a staircase well in view."""
    from perception.data.label_grid import encode_grid
    from perception.data.synthetic import FrameConfig, draw_frame
    from stair_env.sampling import Scene, SceneSampler

    rng = np.random.default_rng(0)
    config = FrameConfig(sampler=SceneSampler(negatives=0.0, lighting="day", direction="up"))
    while True:
        frame = draw_frame(rng, config)
        grid = encode_grid(frame.lines)
        if grid.cls.sum() >= MIN_CELLS:
            return Sample(frame, Scene(frame.scene), grid.cls, grid.loc)


@functools.cache
def _eager(width: float) -> Any:
    import torch

    from perception.network import StairNetV2

    torch.manual_seed(0)
    return StairNetV2(width=width).eval()


@functools.cache
def _fast(width: float, backend: str) -> Any:
    """The same network behind one of the back ends."""
    from perception.inference.backends import TorchBackend, make_exported_backend
    from perception.inference.weights import export_onnx

    if backend == "torch":
        return TorchBackend(network=_eager(width))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "network.onnx"
        export_onnx(_eager(width), path)
        return make_exported_backend(backend, path)


def _run_eager(width: float, rgb: np.ndarray, depth_m: np.ndarray) -> None:
    """A forward pass as a notebook would write it."""
    import torch

    from perception.inference.preprocess import colour_input, depth_input

    with torch.no_grad():
        _eager(width)(torch.from_numpy(colour_input(rgb[None])), torch.from_numpy(depth_input(depth_m[None])))


def fast_against_eager(rounds: int, backend: str, width: float, target: float) -> Row:
    """A back end against torch eager, one frame."""
    frame, fast = sample_frame().frame, _fast(width, backend)
    return time_pair(
        f"StairNetV2 {width:g}x, {backend} / torch eager",
        seconds_per_call(lambda: fast(frame.rgb[None], frame.depth_m[None]), 2),
        seconds_per_call(lambda: _run_eager(width, frame.rgb, frame.depth_m)),
        rounds=rounds,
        target=target,
    )


def after_the_network(rounds: int, backend: str) -> Row:
    """Decode, cluster, geometry against the 0.25x network on a back end."""
    sample, fast, interpret = sample_frame(), _fast(0.25, backend), _interpreter()
    frame = sample.frame
    return time_pair(
        f"all after the network / the network (0.25x, {backend})",
        seconds_per_call(interpret, 5),
        seconds_per_call(lambda: fast(frame.rgb[None], frame.depth_m[None])),
        rounds=rounds,
        target=5.0,
    )


def _interpreter() -> Any:
    from perception.estimator import StairEstimator
    from perception.reproduction.ideal_detector import IdealDetector

    sample, estimator = sample_frame(), StairEstimator(detector=IdealDetector())
    frame = sample.frame
    return lambda: estimator.interpret(sample.cls, sample.loc, frame.depth_m, frame.intrinsics, frame.gravity)


def perceived_frame(rounds: int, backend: str) -> Row:
    """Render, corrupt, detect, measure: ours against the naive chain, in a scene that holds no robot."""
    import pybullet

    from perception.geometry.paper import measure_stairs_as_the_paper
    from stair_env.sensors.camera.renderers import make_renderer
    from stair_env.sensors.camera.sensor import CameraConfig, RgbdCamera

    sample, fast, interpret = sample_frame(), _fast(0.25, backend), _interpreter()
    frame = sample.frame
    renderer = make_renderer("raycast", sample.scene)
    camera = RgbdCamera(CameraConfig(latency_s=0.0), renderer, np.random.default_rng(0))
    camera.intrinsics = frame.intrinsics
    clock = iter(range(10**9))
    client = pybullet.connect(pybullet.DIRECT)
    add_visuals(client, sample.scene.shapes)

    def ours() -> None:
        reading = camera.step(float(next(clock)), frame.camera_to_world)
        fast(reading.rgb[None], reading.depth_m[None])
        interpret()

    def theirs() -> None:
        rgb, depth_m = tiny_picture(client, frame.camera_to_world, frame.intrinsics)
        _run_eager(0.25, rgb, depth_m)
        lines = naive_lines(sample.cls, sample.loc)
        measure_stairs_as_the_paper(lines, frame.depth_m, frame.intrinsics, frame.gravity)

    try:
        return time_pair(
            f"perceived frame without a robot ({backend}) / naive chain",
            seconds_per_call(ours),
            seconds_per_call(theirs),
            rounds=rounds,
            target=6.0,
        )
    finally:
        pybullet.disconnect(client)


def perceived_frame_walking(rounds: int, backend: str) -> Row:
    """The same on a walking robot: the shipped weights, the tracker too, and a Bullet world with the robot in it."""
    import torch

    from perception.geometry.lines import to_image_pixels
    from perception.geometry.paper import measure_stairs_as_the_paper
    from perception.inference.backends import as_grids
    from perception.inference.preprocess import colour_input, depth_input, letterbox
    from perception.inference.weights import load_network

    env, plain = (_walked(backend, {"renderer": name}) for name in ("raycast", "tiny"))
    base, bullet, network = env.unwrapped, plain.unwrapped, load_network(0.25)
    perception, estimator, now = env.get_wrapper_attr("perception"), env.get_wrapper_attr("estimator"), base.time_s
    intrinsics, gravity, clock = base.camera_intrinsics, perception.gravity_at(now), itertools.count(int(now) + 1)

    def ours() -> None:
        reading = base._camera.step(float(next(clock)), _camera_pose(base), base._body_shapes.shapes)
        estimate = estimator.estimate(reading.rgb, reading.depth_m, intrinsics, gravity)
        perception.look(estimate, reading.frame_index, now)
        perception.block()

    def theirs() -> None:
        rgb, depth_m = tiny_picture(bullet._sim.client._client, _camera_pose(bullet), intrinsics)
        square_rgb, square_depth = letterbox(rgb, depth_m)
        with torch.no_grad():
            pair = torch.from_numpy(colour_input(square_rgb[None])), torch.from_numpy(depth_input(square_depth[None]))
            cls, loc = as_grids(*(part.numpy() for part in network(*pair)))
        lines = to_image_pixels(naive_lines(cls[0], loc[0]), intrinsics.width, intrinsics.height)
        measure_stairs_as_the_paper(lines, depth_m, intrinsics, gravity)

    try:
        name = f"perceived frame on a walking robot ({backend}) / naive chain"
        return time_pair(name, seconds_per_call(ours), seconds_per_call(theirs), rounds=rounds, target=6.0)
    finally:
        env.close()
        plain.close()


def _walked(backend: str, camera: dict[str, str]) -> Any:
    """A robot that has walked up to a staircase and sees it."""
    import gymnasium as gym

    from stair_env.stairs import StairSpec

    estimator = {"backend": backend}
    env = gym.make(PERCEPTION_ID, disable_env_checker=True, camera=camera, estimator=estimator)
    env.reset(seed=0, options={"stairs": StairSpec(riser_height=0.15, tread_depth=0.30, num_steps=6)})
    for _ in range(WALKED_STEPS):
        env.step(np.zeros(env.action_space.shape or (), np.float32))
    return env


def _camera_pose(env: Any) -> np.ndarray:
    """(4, 4) camera_to_world of an RGBD environment."""
    from stair_env.physics.simulation import base_to_world
    from stair_env.robots import mount_to_base

    pose: np.ndarray = base_to_world(env.state.after) @ mount_to_base(env.robot.camera)
    return pose


def naive_lines(cls: np.ndarray, loc: np.ndarray) -> np.ndarray:
    """Decode and cluster cell by cell in plain Python, as the paper's text reads.

    Args:
        cls, loc: (32, 16) and (32, 16, 8) grids of one image.

    Returns:
        (m, 8) rows x1 y1 x2 y2 k b score support, pixels of the 512 x 512 image.
    """
    rows, columns = cls.shape
    middle = columns // 2
    order = [middle - 1, middle]
    for offset in range(1, middle):
        order += [middle - 1 - offset, middle + offset]
    clusters: list[list[list[float]]] = []
    for column in order:
        for row in range(rows):
            if cls[row, column] < 0.5:
                continue
            for half in range(2):
                x1, y1, x2, y2 = loc[row, column, 4 * half : 4 * half + 4]
                segment = [
                    float((column + x1) * CELL_WIDTH_PX),
                    float((row + y1) * CELL_HEIGHT_PX),
                    float((column + x2) * CELL_WIDTH_PX),
                    float((row + y2) * CELL_HEIGHT_PX),
                ]
                _join_nearest(clusters, segment)
    found = []
    for cluster in clusters:
        k, b = _fit(cluster)
        left, right = min(s[0] for s in cluster), max(s[2] for s in cluster)
        found.append([left, k * left + b, right, k * right + b, k, b, 1.0, float(len(cluster))])
    return np.array(found).reshape(-1, 8)


def _join_nearest(clusters: list[list[list[float]]], segment: list[float]) -> None:
    x, y = (segment[0] + segment[2]) / 2, (segment[1] + segment[3]) / 2
    best, best_distance = None, CLUSTER_PX
    for cluster in clusters:
        k, b = _fit(cluster)
        distance = abs(k * x + b - y)
        if distance < best_distance:
            best, best_distance = cluster, distance
    if best is None:
        clusters.append([segment])
    else:
        best.append(segment)


def _fit(cluster: list[list[float]]) -> tuple[float, float]:
    """Slope and intercept by least squares through a cluster's end points."""
    x = [value for segment in cluster for value in (segment[0], segment[2])]
    y = [value for segment in cluster for value in (segment[1], segment[3])]
    k, b = np.polyfit(x, y, 1)
    return float(k), float(b)


def batched_frames(rounds: int, backend: str) -> Row:
    """The network on the frames of eight environments at once against one after the other."""
    frame, fast = sample_frame().frame, _fast(0.25, backend)
    rgb, depth = np.stack([frame.rgb] * MANY_ENVS), np.stack([frame.depth_m] * MANY_ENVS)

    def one_by_one() -> None:
        for index in range(MANY_ENVS):
            fast(rgb[index : index + 1], depth[index : index + 1])

    return time_pair(
        f"{MANY_ENVS} frames in a batch / one by one (0.25x, {backend})",
        seconds_per_call(lambda: fast(rgb, depth)),
        seconds_per_call(one_by_one),
        rounds=rounds,
        target=1.0,
    )


def training_step(rounds: int, backend: str, width: float) -> Row:
    """Forward and backward over a batch of fine-tuning: our grouped convolutions against dense ones, on one thread."""
    import torch

    from perception.network import StairNetV2, use_compiled_convolutions, use_merged_norms

    network = StairNetV2(width).eval().use_dense_convolutions()
    use_merged_norms(network)
    rgb, depth = torch.randn(TRAINED_FRAMES, 3, 512, 512), torch.randn(TRAINED_FRAMES, 1, 512, 512)

    def step(compiled: bool) -> None:
        use_compiled_convolutions(network, compiled)
        network.zero_grad()
        raw = network.forward_raw(rgb, depth)
        (raw.cls_logits.square().mean() + raw.loc.square().mean()).backward()

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return time_pair(
            f"training step of {TRAINED_FRAMES} frames, {width:g}x: own convolutions / dense",
            seconds_per_call(lambda: step(True)),
            seconds_per_call(lambda: step(False)),
            rounds=rounds,
            warm_up=2,
            target=1.2,
        )
    finally:
        torch.set_num_threads(threads)


ROWS: dict[str, Callable[[int, str], Row]] = {  # of the number of rounds and the back end
    "network-0.25": functools.partial(fast_against_eager, width=0.25, target=2.0),
    "network-1": functools.partial(fast_against_eager, width=1.0, target=1.6),
    "after-network": after_the_network,
    "perceived-frame": perceived_frame,
    "perceived-frame-walking": perceived_frame_walking,
    "batch": batched_frames,
    "training-0.25": functools.partial(training_step, width=0.25),
    "training-0.5": functools.partial(training_step, width=0.5),
}
