"""The numpy border: bad input is named, nonsense is not valid, nothing is ever NaN."""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from perception.drawing import draw_clusters, draw_estimate, draw_report, draw_section
from perception.estimator import StairEstimator
from perception.geometry.results import StairEstimate
from perception.reproduction.ideal_detector import IdealDetector
from stair_env.common.transforms import look_along
from stair_env.intrinsics import D435I_COLOR_MODES, Intrinsics
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.labels import LineLabel, visible_edges
from stair_env.sensors.camera.renderers.factory import make_renderer
from stair_env.stairs import StairSpec

CAMERA = D435I_COLOR_MODES["640x480"]
LEVEL = np.array([0.0, -9.8, 0.0])


class RandomDetector:
    """Answers noise."""

    def __init__(self, seed: int, level: float = 1.0) -> None:
        self._rng, self._level = np.random.default_rng(seed), level

    def detect(self, rgb: Sequence[np.ndarray], depth_m: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        count = len(rgb)
        return self._level * self._rng.random((count, 32, 16)), self._rng.random((count, 32, 16, 8))


@functools.cache
def frame(direction: str = "up", tread: float = 0.30) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[LineLabel]]:
    """rgb, depth, gravity, labels of a rendered staircase."""
    spec = StairSpec(direction=direction, riser_height=tread / 2, tread_depth=tread)  # type: ignore[arg-type]
    scene = Scene(SceneSpec(spec))
    floor = float(scene.spec.stairs.profile().level_z[0])  # type: ignore[union-attr]
    pose = look_along(np.array([-0.9, 0.0, floor + 0.9]), 0.1, 0.5 if direction == "up" else 0.75, 0.03)
    drawn = make_renderer("raycast", scene).render(CAMERA, pose)
    return drawn.rgb, drawn.depth_m, 9.8 * pose[2, :3], visible_edges(scene.edges, CAMERA, pose, drawn)


def ideal(*directions: str) -> StairEstimator:
    detector = IdealDetector()
    for direction in directions:
        detector.show(frame(direction)[3], CAMERA.width, CAMERA.height)
    return StairEstimator(detector=detector)


def numbers(estimate: StairEstimate) -> list[float]:
    """Every number in an estimate."""
    found: list[float] = []

    def collect(value: Any) -> None:
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            found.append(float(value))
        elif isinstance(value, dict):
            for part in value.values():
                collect(part)
        elif isinstance(value, (list, tuple)):
            for part in value:
                collect(part)

    collect(dataclasses.asdict(estimate))
    return found


@pytest.mark.parametrize(("direction", "sign"), [("up", 1), ("down", -1)])
def test_measures_what_is_there(direction: str, sign: int) -> None:
    rgb, depth, gravity, _ = frame(direction)
    estimate = ideal(direction).estimate(rgb, depth, CAMERA, gravity)
    assert estimate.valid and estimate.reason == ""
    assert estimate.direction == sign
    assert estimate.direction_name == {1: "ascending", -1: "descending"}[sign]
    assert len(estimate.steps) >= 3
    for step in estimate.steps[:3]:
        assert step.width_m == pytest.approx(0.30, abs=0.003)
        assert step.height_m == pytest.approx(0.15, abs=0.003)
        assert 0.0 < step.width_std_m < 0.05
    assert estimate.next_edge_m == pytest.approx(0.9, abs=0.01)
    assert estimate.yaw_rad == pytest.approx(-0.1, abs=0.01)
    assert estimate.pitch_rad == pytest.approx(-0.5 if direction == "up" else -0.75, abs=0.01)
    assert estimate.roll_rad == pytest.approx(0.03, abs=0.01)
    lowest = [line.y1 + line.y2 for line in estimate.lines]
    assert lowest == sorted(lowest, reverse=True)


@pytest.mark.parametrize("direction", ["up", "down"])
@pytest.mark.parametrize("tread", [0.15, 0.20])
def test_the_narrowest_treads_of_the_environments_are_measured(direction: str, tread: float) -> None:
    rgb, depth, gravity, labels = frame(direction, tread)
    detector = IdealDetector()
    detector.show(labels, CAMERA.width, CAMERA.height)
    steps = StairEstimator(detector=detector).estimate(rgb, depth, CAMERA, gravity).steps
    assert steps
    for step in steps[:2]:
        assert (step.width_m, step.height_m) == pytest.approx((tread, tread / 2), abs=0.006)


def test_detect_gives_the_grids() -> None:
    rgb, depth, _, _ = frame()
    cls, loc = ideal("up").detect(rgb, depth)
    assert cls.shape == (32, 16)
    assert loc.shape == (32, 16, 8)


def test_a_batch_is_the_same_as_single_frames() -> None:
    both = [frame("up"), frame("down")]
    rgb, depth, gravity, _ = (list(part) for part in zip(*both))
    batch = ideal("up", "down").estimate_batch(rgb, depth, [CAMERA, CAMERA], gravity)
    singles = [ideal(d).estimate(*frame(d)[:2], CAMERA, frame(d)[2]) for d in ("up", "down")]
    assert batch == singles


def test_an_empty_batch_is_empty() -> None:
    assert StairEstimator(detector=IdealDetector()).estimate_batch([], [], [], []) == []


def test_uneven_batch_is_named() -> None:
    rgb, depth, gravity, _ = frame()
    with pytest.raises(ValueError, match="equally many"):
        ideal("up").estimate_batch([rgb], [depth, depth], [CAMERA], [gravity])


def test_estimates_are_json_and_frozen() -> None:
    rgb, depth, gravity, _ = frame()
    estimate = ideal("up").estimate(rgb, depth, CAMERA, gravity)
    read = json.loads(json.dumps(estimate.to_dict()))
    assert read["valid"] is True
    assert read["steps"][0]["width_m"] == pytest.approx(estimate.steps[0].width_m)
    assert {"lines", "steps", "direction", "pitch_rad", "roll_rad", "yaw_rad", "valid"} <= set(read)
    with pytest.raises(dataclasses.FrozenInstanceError):
        estimate.valid = False  # type: ignore[misc]


BAD_DEPTH = {
    "nan": lambda d: np.full_like(d, np.nan),
    "inf": lambda d: np.full_like(d, np.inf),
    "zero": lambda d: np.zeros_like(d),
    "negative": lambda d: -d,
    "one pixel": lambda d: np.where(np.arange(d.size).reshape(d.shape) == d.size // 2, d, np.float32(0.0)),
    "tiny": lambda d: np.full_like(d, 1e-6),
    "huge": lambda d: np.full_like(d, 1e6),
}


@pytest.mark.parametrize("kind", BAD_DEPTH)
@pytest.mark.parametrize("method", ["planes", "paper"])
def test_depth_without_information_is_not_valid(kind: str, method: Any) -> None:
    rgb, depth, gravity, labels = frame()
    detector = IdealDetector()
    detector.show(labels, CAMERA.width, CAMERA.height)
    estimate = StairEstimator(detector=detector, method=method).estimate(rgb, BAD_DEPTH[kind](depth), CAMERA, gravity)
    assert not estimate.valid
    assert estimate.reason
    assert estimate.direction == 0 and not estimate.steps
    assert np.isfinite(numbers(estimate)).all()


def test_partly_broken_depth_still_measures() -> None:
    rgb, depth, gravity, _ = frame()
    broken = depth.copy()
    broken[:, ::3] = np.nan
    broken[::4] = np.inf
    estimate = ideal("up").estimate(rgb, broken, CAMERA, gravity)
    assert estimate.valid
    assert estimate.steps[0].width_m == pytest.approx(0.30, abs=0.005)


def test_a_black_image_without_lines_is_not_valid() -> None:
    rgb, depth, gravity, _ = frame()
    detector = IdealDetector()
    detector.show([], CAMERA.width, CAMERA.height)
    estimate = StairEstimator(detector=detector).estimate(np.zeros_like(rgb), depth, CAMERA, gravity)
    assert not estimate.valid
    assert estimate.reason == "no stair lines"


def estimate_with(**changes: Any) -> StairEstimate:
    rgb, depth, gravity, _ = frame()
    given = {"rgb": rgb, "depth": depth, "intrinsics": CAMERA, "gravity": gravity, **changes}
    return ideal("up").estimate(given["rgb"], given["depth"], given["intrinsics"], given["gravity"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rgb": np.zeros((480, 640), np.uint8)}, "rgb has shape"),
        ({"rgb": np.zeros((480, 640, 4), np.uint8)}, "rgb has shape"),
        ({"rgb": np.zeros((480, 640, 3), np.float32)}, "rgb has dtype"),
        ({"rgb": "picture.png"}, "rgb has shape"),
        ({"depth": np.zeros((240, 320), np.float32)}, "depth has shape"),
        ({"depth": np.zeros((480, 640), np.uint16)}, "depth has dtype"),
        ({"intrinsics": D435I_COLOR_MODES["848x480"]}, "intrinsics are those of a 848x480 image"),
        ({"intrinsics": np.eye(3)}, "must be stair_env"),
        ({"gravity": np.zeros(3)}, "no length"),
        ({"gravity": np.array([0.0, np.nan, 0.0])}, "three finite"),
        ({"gravity": np.array([0.0, -9.8])}, "three finite"),
    ],
)
def test_wrong_input_is_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        estimate_with(**changes)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"width": 0.3}, "width=0.3"), ({"backend": "tensorflow"}, "backend"), ({"method": "guess"}, "method")],
)
def test_wrong_options_are_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        StairEstimator(detector=IdealDetector(), **options)


def check_random_tensors(count: int, seed: int) -> None:
    rgb, depth, gravity, _ = frame()
    rng = np.random.default_rng(seed)
    for method in ("planes", "paper"):
        for level in (0.55, 1.0):
            detector = RandomDetector(seed, level)
            estimator = StairEstimator(detector=detector, method=method)  # type: ignore[arg-type]
            for _ in range(count):
                estimate = estimator.estimate(rgb, depth, CAMERA, gravity + rng.normal(0, 1, 3))
                assert np.isfinite(numbers(estimate)).all()
                assert estimate.valid == bool(estimate.direction)


def test_random_tensors_never_raise() -> None:
    check_random_tensors(10, seed=0)


@pytest.mark.slow
def test_ten_thousand_random_tensors_never_raise() -> None:
    check_random_tensors(2500, seed=1)


@pytest.mark.parametrize("size", [(480, 640), (512, 512), (97, 64), (720, 1280)])
def test_any_image_size(size: tuple[int, int]) -> None:
    height, width = size
    focal = 0.9 * max(size)
    camera = Intrinsics(width, height, focal, focal, width / 2, height / 2)
    estimator = StairEstimator(detector=RandomDetector(3))
    estimate = estimator.estimate(np.zeros((*size, 3), np.uint8), np.ones(size, np.float32), camera, LEVEL)
    assert np.isfinite(numbers(estimate)).all()


def test_pictures_show_the_estimate_and_leave_the_image_alone() -> None:
    rgb, depth, gravity, _ = frame()
    estimator = ideal("up")
    grid = estimator.detect(rgb, depth)
    estimate = estimator.interpret(*grid, depth, CAMERA, gravity)
    before = rgb.copy()
    drawn = draw_estimate(rgb, estimate, {"valid": 1.0, "step_width": 0.3, "step_height": 0.15})
    assert drawn.shape == rgb.shape and drawn.dtype == np.uint8
    assert (drawn != rgb).any()
    assert np.array_equal(rgb, before)
    assert (draw_clusters(rgb, *grid) != rgb).any()
    assert draw_section(estimate, (300, 200)).shape == (200, 300, 3)
    assert draw_report(rgb, estimate, grid).shape[0] == rgb.shape[0]


def test_pictures_of_nothing() -> None:
    nothing = StairEstimate(valid=False, reason="no stair lines")
    rgb = np.zeros((120, 160, 3), np.uint8)
    assert draw_estimate(rgb, nothing).shape == rgb.shape
    assert draw_section(nothing).shape == (300, 420, 3)
    assert math.isclose(float(draw_clusters(rgb, np.zeros((32, 16)), np.zeros((32, 16, 8))).sum()), 0.0)
