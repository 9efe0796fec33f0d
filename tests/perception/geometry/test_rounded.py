"""Round creases, partial depth, and gravity that is wrong or unknown: the same steps, or a reason that tells."""

from __future__ import annotations

import functools
import math

import cv2
import numpy as np
import pytest

from perception.estimator import StairEstimator
from perception.geometry.planes import Geometry, measure_stairs
from perception.geometry.results import StairEstimate
from perception.geometry.strips.levelling import turn_pitch, turn_sideways
from perception.reproduction.ideal_detector import IdealDetector
from stair_env.common.transforms import look_along
from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.labels import LineLabel, visible_edges
from stair_env.sensors.camera.renderers.factory import make_renderer
from stair_env.stairs import StairSpec

CAMERA = D435I_COLOR_MODES["640x480"]
RISER_M, TREAD_M, DISTANCE_M = 0.15, 0.30, 0.9
BOTH = ("up", "down")


class Sight:
    """A staircase of equal steps and everything that a frame of it holds."""

    def __init__(self, direction: str) -> None:
        scene = Scene(SceneSpec(StairSpec(direction=direction, riser_height=RISER_M, tread_depth=TREAD_M)))  # type: ignore[arg-type]
        assert scene.spec.stairs is not None
        floor = float(scene.spec.stairs.profile().level_z[0])
        height, pitch = (0.9, 0.5) if direction == "up" else (1.1, 0.75)
        pose = look_along(np.array([-DISTANCE_M, 0.0, floor + height]), 0.1, pitch, 0.03)
        frame = make_renderer("raycast", scene).render(CAMERA, pose)
        self.rgb, self.depth = frame.rgb, frame.depth_m
        self.labels: list[LineLabel] = visible_edges(scene.edges, CAMERA, pose, frame)
        self.gravity = 9.8 * pose[2, :3]

    def measure(self, depth: np.ndarray, gravity: np.ndarray | None) -> StairEstimate:
        detector = IdealDetector()
        detector.show(self.labels, CAMERA.width, CAMERA.height)
        return StairEstimator(detector=detector).estimate(self.rgb, depth, CAMERA, gravity)

    def rows_of_lines(self) -> list[np.ndarray]:
        """Image row of every line in every column, outside of it too."""
        x = np.arange(CAMERA.width) + 0.5
        return [line.y1 + (line.y2 - line.y1) / (line.x2 - line.x1) * (x - line.x1) for line in self.labels]


@functools.cache
def sight(direction: str) -> Sight:
    return Sight(direction)


def tilted(gravity: np.ndarray, degrees: float, azimuth: float) -> np.ndarray:
    """Gravity turned by so much about a horizontal axis."""
    down = gravity / np.linalg.norm(gravity)
    right = np.cross(down, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axis = math.cos(azimuth) * right + math.sin(azimuth) * np.cross(down, right)
    angle = math.radians(degrees)
    return np.asarray(gravity * math.cos(angle) + np.cross(axis, gravity) * math.sin(angle))


def rounded(depth: np.ndarray, std_px: float) -> np.ndarray:
    """Inverse depth, which is what stereo measures, blurred."""
    inverse = np.where(depth > 0.0, 1.0 / np.maximum(depth, 1e-3), 0.0)
    blurred = cv2.GaussianBlur(inverse, (0, 0), std_px)
    return np.where(depth > 0.0, 1.0 / np.maximum(blurred, 1e-3), 0.0).astype(np.float32)


def check(estimate: StairEstimate, direction: str, width_m: float, height_m: float, steps: int = 3) -> None:
    assert estimate.valid, estimate.reason
    assert estimate.direction_name == {"up": "ascending", "down": "descending"}[direction]
    assert len(estimate.steps) >= steps
    for step in estimate.steps[:3]:
        assert step.width_m == pytest.approx(TREAD_M, abs=width_m)
        assert step.height_m == pytest.approx(RISER_M, abs=height_m)


@pytest.mark.parametrize("azimuth", [0.0, 1.6, 3.1, 4.7])
@pytest.mark.parametrize("degrees", [3.0, 5.5])
@pytest.mark.parametrize("direction", BOTH)
def test_gravity_off_by_up_to_six_degrees_gives_the_same_steps(direction: str, degrees: float, azimuth: float) -> None:
    seen = sight(direction)
    estimate = seen.measure(seen.depth, tilted(seen.gravity, degrees, azimuth))
    check(estimate, direction, 0.008, 0.008)
    assert estimate.gravity_source == "refined"
    assert math.degrees(estimate.gravity_correction_rad) == pytest.approx(degrees, abs=1.0)


@pytest.mark.parametrize("direction", BOTH)
def test_the_attitude_is_the_corrected_one(direction: str) -> None:
    seen = sight(direction)
    plain, mended = seen.measure(seen.depth, seen.gravity), seen.measure(seen.depth, tilted(seen.gravity, 5.0, 0.7))
    assert plain.gravity_source == "imu"
    assert math.degrees(plain.gravity_correction_rad) < 0.5
    assert mended.pitch_rad == pytest.approx(plain.pitch_rad, abs=math.radians(1.0))
    assert mended.roll_rad == pytest.approx(plain.roll_rad, abs=math.radians(1.0))


@pytest.mark.parametrize("degrees", [8.0, 10.0])
@pytest.mark.parametrize("azimuth", [0.0, 3.1])
def test_beyond_six_degrees_the_reason_says_by_how_many(degrees: float, azimuth: float) -> None:
    seen = sight("up")
    estimate = seen.measure(seen.depth, tilted(seen.gravity, degrees, azimuth))
    assert not estimate.valid and not estimate.steps
    found = int(estimate.reason.split(" degrees")[0].split()[-1])
    assert found == pytest.approx(degrees, abs=1.1)


@pytest.mark.parametrize("std_px", [0.0, 5.0])
@pytest.mark.parametrize("direction", BOTH)
def test_without_gravity_depth_tells_what_is_upright(direction: str, std_px: float) -> None:
    seen = sight(direction)
    estimate = seen.measure(rounded(seen.depth, std_px) if std_px else seen.depth, None)
    check(estimate, direction, 0.02, 0.015)
    assert estimate.gravity_source == "depth"
    assert estimate.pitch_rad == pytest.approx(-0.5 if direction == "up" else -0.75, abs=0.03)


@pytest.mark.parametrize("std_px", [4.0, 7.0, 10.0])
@pytest.mark.parametrize("direction", BOTH)
def test_rounded_creases(direction: str, std_px: float) -> None:
    seen = sight(direction)
    check(seen.measure(rounded(seen.depth, std_px), seen.gravity), direction, 0.012, 0.008)


@pytest.mark.parametrize("direction", BOTH)
def test_single_holes_blobs_and_a_patch_at_half_the_distance(direction: str) -> None:
    seen, rng = sight(direction), np.random.default_rng(0)
    depth = rounded(seen.depth, 4.0)
    depth[180:300, 60:180] *= 0.5
    depth[rng.random(depth.shape) < 0.2] = 0.0
    blobs = cv2.resize((rng.random((30, 40)) < 0.15).astype(np.float32), (640, 480)) > 0.5
    depth[blobs] = 0.0
    check(seen.measure(depth, seen.gravity), direction, 0.015, 0.01)


@pytest.mark.parametrize("half_px", [4.0, 8.0])
@pytest.mark.parametrize("direction", BOTH)
def test_lines_without_depth_along_them(direction: str, half_px: float) -> None:
    seen = sight(direction)
    depth, row = seen.depth.copy(), np.arange(CAMERA.height)[:, None] + 0.5
    for line in seen.rows_of_lines():
        depth[np.abs(row - line) < half_px] = 0.0
    check(seen.measure(depth, seen.gravity), direction, 0.012, 0.01, steps=2)


def test_a_band_without_depth_leaves_the_other_steps() -> None:
    seen = sight("up")
    depth = rounded(seen.depth, 4.0)
    depth[250:330] = 0.0
    estimate = seen.measure(depth, seen.gravity)
    check(estimate, "up", 0.02, 0.015, steps=1)


def test_uncertainty_grows_as_depth_gets_worse() -> None:
    seen, rng = sight("up"), np.random.default_rng(1)
    smooth = cv2.resize(rng.normal(size=(48, 64)), (640, 480))
    rough = rounded(seen.depth, 4.0)
    rough = (1.0 / (1.0 / rough + 0.02 * smooth)).astype(np.float32)
    fine, coarse = (seen.measure(depth, seen.gravity) for depth in (seen.depth, rough))
    assert coarse.valid
    assert coarse.steps[0].width_std_m > 1.3 * fine.steps[0].width_std_m


@pytest.mark.parametrize("steepness", [0.3, 0.5])
def test_stripes_on_a_ramp_are_no_stairs(steepness: float) -> None:
    """Equal stripes across a slope as steep as stairs, seen from 1 m above it."""
    pitch = 0.45
    rays = CAMERA.rays()
    down = math.cos(pitch) * rays[..., 1] + math.sin(pitch)
    ahead = math.cos(pitch) - math.sin(pitch) * rays[..., 1]
    depth = (1.0 / np.maximum(down + steepness * ahead, 0.1)).astype(np.float32)
    ahead_m = np.arange(0.7, 3.0, 0.16)
    down_m = 1.0 - steepness * ahead_m
    y = math.cos(pitch) * down_m - math.sin(pitch) * ahead_m
    z = math.cos(pitch) * ahead_m + math.sin(pitch) * down_m
    v = CAMERA.cy + CAMERA.fy * y / z
    v = v[(v > 10.0) & (v < 470.0)]
    lines = np.array([[50.0, row, 590.0, row, 0.0, row, 1.0, 12.0] for row in v])
    found = measure_stairs(lines, depth, CAMERA, 9.8 * np.array([0.0, -math.cos(pitch), -math.sin(pitch)]))
    assert not found.steps


@pytest.mark.parametrize("gravity", [None, np.array([0.0, -9.8, 0.0])])
@pytest.mark.parametrize("seed", range(8))
def test_nonsense_never_raises_or_gives_nan(seed: int, gravity: np.ndarray | None) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(0, 14))
    y = np.sort(rng.uniform(0, CAMERA.height, count))
    lines = np.stack([np.full(count, 50.0), y, np.full(count, 590.0), y, 0 * y, y, 0 * y + 1, 0 * y + 9], axis=1)
    depth = (rng.random((CAMERA.height, CAMERA.width)) * rng.choice([0.0, 0.2, 5.0])).astype(np.float32)
    found: Geometry = measure_stairs(lines, depth, CAMERA, gravity)
    assert np.isfinite([[s.width_m, s.height_m, s.width_std_m, s.height_std_m] for s in found.steps]).all()
    assert np.isfinite([found.yaw_rad, found.yaw_std_rad, found.gravity_correction_rad]).all()


def test_the_papers_method_needs_gravity() -> None:
    seen = sight("up")
    detector = IdealDetector()
    detector.show(seen.labels, CAMERA.width, CAMERA.height)
    with pytest.raises(ValueError, match="gravity"):
        StairEstimator(detector=detector, method="paper").estimate(seen.rgb, seen.depth, CAMERA, None)


def test_turns_are_rotations_with_the_stated_signs() -> None:
    ahead = np.array([1.0, 0.0, 0.0])
    assert (turn_pitch(0.1) @ ahead)[2] == pytest.approx(math.sin(0.1))
    assert (turn_sideways(0.0, 0.1) @ ahead)[1] == pytest.approx(math.sin(0.1))
    for turn in (turn_pitch(0.3), turn_sideways(0.2, -0.1)):
        assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-12)
