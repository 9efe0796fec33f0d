"""Geometry against rendered staircases whose sizes are known."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from perception.geometry.paper import measure_stairs_as_the_paper
from perception.geometry.planes import (
    Geometry,
    attitude_angles,
    camera_to_level,
    level_to_stair,
    line_normals,
    measure_stairs,
    yaw_from_lines,
)
from stair_env.common.transforms import look_along
from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.labels import LineLabel, visible_edges
from stair_env.sensors.camera.renderers.factory import make_renderer
from stair_env.stairs import StairSpec

CAMERA = D435I_COLOR_MODES["640x480"]
G = 9.8


@functools.cache
def scene(direction: str) -> Scene:
    return Scene(
        SceneSpec(
            StairSpec(
                direction=direction,  # type: ignore[arg-type]
                riser_height=0.15,
                tread_depth=0.30,
                num_steps=6,
                riser_offsets=(0.01, -0.01, 0.005, 0.0, 0.0, 0.0),
                tread_offsets=(-0.01, 0.01, -0.005, 0.0, 0.0, 0.0),
            )
        )
    )


def rows_of(labels: list[LineLabel]) -> np.ndarray:
    rows = []
    for label in labels:
        k = (label.y2 - label.y1) / (label.x2 - label.x1)
        rows.append([label.x1, label.y1, label.x2, label.y2, k, label.y1 - k * label.x1, 1.0, 10.0])
    return np.array(rows).reshape(-1, 8)


class View:
    """A staircase seen from somewhere."""

    def __init__(self, direction: str, distance: float, height: float, yaw: float, pitch: float, roll: float) -> None:
        self.spec = scene(direction).spec.stairs
        assert self.spec is not None
        self.profile = self.spec.profile()
        floor = float(self.profile.level_z[0])
        self.pose = look_along(np.array([-distance, -0.8 * math.tan(yaw), floor + height]), yaw, pitch, roll)
        renderer = make_renderer("raycast", scene(direction))
        frame = renderer.render(CAMERA, self.pose)
        self.depth = frame.depth_m
        self.lines = rows_of(visible_edges(scene(direction).edges, CAMERA, self.pose, frame))
        self.gravity = G * self.pose[2, :3]
        self.distance, self.yaw = distance, yaw

    def measure(self, **changes: np.ndarray) -> Geometry:
        return measure_stairs(
            changes.get("lines", self.lines),
            changes.get("depth", self.depth),
            CAMERA,
            changes.get("gravity", self.gravity),
        )

    def errors_mm(self, found: Geometry) -> np.ndarray:
        """(n, 3) width, height, distance errors of the steps, matched by distance."""
        rows = []
        for step in found.steps:
            index = int(np.argmin(np.abs(self.profile.edge_x[:-1] - self.distance_x - step.distance_m)))
            run = self.profile.edge_x[index + 1] - self.profile.edge_x[index]
            rows.append(
                [
                    step.width_m - run,
                    step.height_m - abs(self.profile.rises[index]),
                    step.distance_m + self.distance_x - self.profile.edge_x[index],
                ]
            )
        return 1000.0 * np.array(rows).reshape(-1, 3)

    @property
    def distance_x(self) -> float:
        return float(self.pose[0, 3])


@functools.cache
def view(direction: str, seed: int) -> View:
    rng = np.random.default_rng(seed)
    distance = float(rng.uniform(0.7, 1.2))
    height = float(rng.uniform(0.5, 0.9)) if direction == "up" else float(rng.uniform(0.8, 1.2))
    drop = 0.1 if direction == "up" else 0.2
    sign = 1.0 if direction == "up" else -1.0
    pitch = math.atan2(height - sign * drop, distance + 0.4)
    yaw, roll = rng.uniform(-0.3, 0.3), rng.uniform(-0.08, 0.08)
    return View(direction, distance, height, float(yaw), pitch, float(roll))


SEEDS = range(6)
BOTH = ("up", "down")


def test_equation_8_signs() -> None:
    assert attitude_angles(np.array([0.0, -G, 0.0])) == pytest.approx((0.0, 0.0))
    pitch, _ = attitude_angles(np.array([0.0, -G * math.cos(0.2), G * math.sin(0.2)]))
    assert pitch == pytest.approx(0.2)  # head up: the force that holds it up has a part along the optical axis
    _, roll = attitude_angles(np.array([-G * math.sin(0.1), -G * math.cos(0.1), 0.0]))
    assert roll == pytest.approx(0.1)  # right side down: up points to the left


@pytest.mark.parametrize("seed", range(20))
def test_levelling_is_a_rotation_that_puts_gravity_down(seed: int) -> None:
    gravity = np.random.default_rng(seed).normal(size=3) * 5.0
    level = camera_to_level(gravity)
    assert level @ level.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(level) == pytest.approx(1.0)
    assert level @ -gravity == pytest.approx([0.0, np.linalg.norm(gravity), 0.0], abs=1e-9)
    assert abs((level @ [0.0, 0.0, 1.0])[0]) < 1e-9 or abs(gravity[2]) > 0.999 * np.linalg.norm(gravity)


@pytest.mark.parametrize("z", [1.0, -1.0])
def test_levelling_survives_looking_straight_down_or_up(z: float) -> None:
    level = camera_to_level(np.array([0.0, 0.0, z]))
    assert np.isfinite(level).all()
    assert np.linalg.det(level) == pytest.approx(1.0)


def test_stair_frame_axes() -> None:
    straight = level_to_stair(0.0)
    assert straight @ [0.0, 0.0, 1.0] == pytest.approx([1.0, 0.0, 0.0])  # forward
    assert straight @ [1.0, 0.0, 0.0] == pytest.approx([0.0, -1.0, 0.0])  # right is minus left
    assert straight @ [0.0, 1.0, 0.0] == pytest.approx([0.0, 0.0, -1.0])  # down is minus up
    looks_right = level_to_stair(0.3) @ [0.0, 0.0, 1.0]
    assert looks_right[1] < 0.0


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("direction", BOTH)
def test_yaw_from_lines_needs_no_depth(direction: str, seed: int) -> None:
    seen = view(direction, seed)
    normals = line_normals(seen.lines, CAMERA) @ camera_to_level(seen.gravity).T
    yaw = yaw_from_lines(normals, seen.lines[:, 2] - seen.lines[:, 0])
    assert yaw == pytest.approx(-seen.yaw, abs=math.radians(0.5))  # world yaw is to the left


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("direction", BOTH)
def test_exact_depth_gives_exact_steps(direction: str, seed: int) -> None:
    seen = view(direction, seed)
    found = seen.measure()
    assert found.direction == (1 if direction == "up" else -1)
    assert len(found.steps) >= 3
    errors = seen.errors_mm(found)
    # The steps differ by up to 20 mm; the estimator, which cannot know that this depth is exact, evens out some of it.
    assert np.abs(errors[:3, :2]).max() < 3.0
    assert np.abs(errors[:3, 2]).max() < 4.0
    assert found.yaw_rad == pytest.approx(-seen.yaw, abs=math.radians(0.2))


@pytest.mark.parametrize("direction", BOTH)
def test_uneven_steps_are_told_apart(direction: str) -> None:
    widths = [step.width_m for step in view(direction, 1).measure().steps[:3]]
    assert widths == pytest.approx([0.29, 0.31, 0.295], abs=0.002)


@pytest.mark.parametrize("direction", BOTH)
def test_size_follows_the_depth_scale(direction: str) -> None:
    seen = view(direction, 0)
    near, far = seen.measure(), seen.measure(depth=seen.depth * np.float32(1.02))
    for a, b in zip(near.steps, far.steps):
        assert b.width_m / a.width_m == pytest.approx(1.02, abs=0.003)
        assert b.height_m / a.height_m == pytest.approx(1.02, abs=0.003)


@pytest.mark.parametrize("direction", BOTH)
def test_holes_and_flying_pixels_do_not_matter(direction: str) -> None:
    seen = view(direction, 2)
    rng = np.random.default_rng(0)
    depth = seen.depth.copy()
    x = np.arange(CAMERA.width)
    for row in seen.lines:  # mixtures within two pixels of every edge
        for offset in range(-2, 3):
            y = np.clip((row[4] * (x + 0.5) + row[5] + offset).astype(int), 0, CAMERA.height - 1)
            depth[y, x] *= rng.uniform(0.9, 1.3, len(x)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.4] = 0.0
    errors = np.abs(seen.errors_mm(seen.measure(depth=depth)))
    assert len(errors) >= 3
    # Going down the mixtures, which are too far on average, pull the jump of depth, and so the width, along.
    assert errors[:3, 0].max() < (3.0 if direction == "up" else 8.0)
    assert errors[:3, 1].max() < 3.0


@pytest.mark.parametrize("direction", BOTH)
def test_stated_errors_are_of_the_right_size(direction: str) -> None:
    """Errors over many noisy frames, in units of the stated standard deviation."""
    rng = np.random.default_rng(1)
    ratios = []
    for seed in SEEDS:
        seen = view(direction, seed)
        for _ in range(5):
            smooth = np.kron(rng.normal(size=(24, 32)), np.ones((20, 20)))
            depth = seen.depth + (0.0036 * seen.depth**2 * smooth).astype(np.float32)
            lines = seen.lines.copy()
            lines[:, 5] += rng.normal(0.0, 0.5 * 640 / 512, len(lines))
            found = seen.measure(depth=depth, lines=lines)
            std = np.array([[step.width_std_m, step.height_std_m] for step in found.steps])
            ratios.extend((seen.errors_mm(found)[:3, :2] / (1000.0 * std[:3])).ravel())
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 1.6


@pytest.mark.parametrize("direction", BOTH)
def test_a_wrong_accelerometer_is_corrected_by_the_faces(direction: str) -> None:
    seen = view(direction, 3)
    tilt = math.radians(0.7)
    cos, sin = math.cos(tilt), math.sin(tilt)
    tilted = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]) @ seen.gravity
    errors = seen.errors_mm(seen.measure(gravity=tilted))
    assert np.abs(errors[:3, :2]).max() < 2.0  # uncorrected: 0.3 m * sin(0.7 deg) = 3.7 mm


@pytest.mark.parametrize("direction", BOTH)
def test_painted_stripes_change_nothing(direction: str) -> None:
    seen = view(direction, 4)
    between = seen.lines.copy()[:1]
    y = np.sort(seen.lines[:, 1] + seen.lines[:, 3])[::-1] / 2.0
    between[:, [1, 3, 5]] += (y[0] + y[1]) / 2.0 - (between[:, 1] + between[:, 3]) / 2.0
    plain, striped = seen.measure(), seen.measure(lines=np.concatenate([seen.lines, between]))
    assert len(striped.steps) == len(plain.steps)
    for a, b in zip(plain.steps, striped.steps):
        assert b.width_m == pytest.approx(a.width_m, abs=0.003)
        assert b.height_m == pytest.approx(a.height_m, abs=0.003)


@pytest.mark.parametrize("direction", BOTH)
@pytest.mark.parametrize("missing", range(4))
def test_a_missed_line_never_makes_a_wrong_step(direction: str, missing: int) -> None:
    seen = view(direction, 5)
    order = np.argsort(-(seen.lines[:, 1] + seen.lines[:, 3]))
    found = seen.measure(lines=np.delete(seen.lines, order[missing], axis=0))
    errors = seen.errors_mm(found)
    assert np.abs(errors[:, :2]).max(initial=0.0) < 30.0


@pytest.mark.parametrize("shift_px", [-5.0, -2.0, 2.0, 5.0])
def test_a_misplaced_nosing_is_put_right_by_depth(shift_px: float) -> None:
    """Going down, one line is some pixels off: the jump in depth says where the tread ends."""
    seen = view("down", 2)
    order = np.argsort(-(seen.lines[:, 1] + seen.lines[:, 3]))
    lines = seen.lines.copy()
    lines[order[1], [1, 3, 5]] += shift_px
    errors = np.abs(seen.errors_mm(seen.measure(lines=lines)))
    uncorrected = 1000.0 * abs(shift_px) / CAMERA.fy * 1.3 / math.sin(0.5)  # about: 1.3 m away, seen 30 degrees down
    assert len(errors) >= 3
    assert errors[:3, 0].max() < 0.75 * uncorrected
    assert errors[:3, 1].max() < 3.0


def test_both_kinds_of_line_when_going_up_only_convex_when_going_down() -> None:
    assert {"convex", "concave"} <= set(view("up", 0).measure().kinds)
    assert "concave" not in view("down", 0).measure().kinds


@pytest.mark.parametrize("pitch", [0.3, 0.6])
def test_lines_on_a_flat_floor_are_no_stairs(pitch: float) -> None:
    """A crosswalk: every strip is the same face."""
    rays = CAMERA.rays()
    down = math.cos(pitch) * rays[..., 1] + math.sin(pitch)
    depth = np.where(down > 0.05, 0.5 / np.maximum(down, 0.05), 0.0).astype(np.float32)
    lines = np.array([[50.0, y, 590.0, y, 0.0, y, 1.0, 12.0] for y in range(240, 460, 30)])
    found = measure_stairs(lines, depth, CAMERA, G * np.array([0.0, -math.cos(pitch), -math.sin(pitch)]))
    assert found.direction == 0
    assert not found.steps


def test_lines_on_a_wall_give_no_step() -> None:
    depth = np.full((CAMERA.height, CAMERA.width), 1.5, dtype=np.float32)
    lines = np.array([[50.0, y, 590.0, y, 0.0, y, 1.0, 12.0] for y in range(100, 400, 40)])
    assert not measure_stairs(lines, depth, CAMERA, np.array([0.0, -G, 0.0])).steps


@pytest.mark.parametrize("seed", range(30))
def test_nonsense_never_raises_or_gives_nan(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(0, 30))
    x1, x2 = np.sort(rng.uniform(0, CAMERA.width, (2, count)), axis=0)
    k, b = rng.normal(0, 0.5, count), rng.uniform(-50, CAMERA.height, count)
    lines = np.stack([x1, k * x1 + b, x2 + 1, k * x2 + b, k, b, np.ones(count), rng.integers(1, 20, count)], axis=1)
    depth = (rng.random((CAMERA.height, CAMERA.width)) * rng.choice([0.0, 0.2, 5.0])).astype(np.float32)
    gravity = rng.normal(size=3)
    for method in (measure_stairs, measure_stairs_as_the_paper):
        found = method(lines, depth, CAMERA, gravity)
        assert np.isfinite([[s.width_m, s.height_m, s.width_std_m, s.height_std_m] for s in found.steps]).all()
        assert np.isfinite([found.yaw_rad, found.yaw_std_rad]).all()
        assert len(found.kinds) == count


@pytest.mark.parametrize("seed", SEEDS)
def test_the_papers_fit_agrees_where_it_is_well_conditioned(seed: int) -> None:
    """Exact depth, going up, seen at an angle: equation 7 can be solved, and finds about the same steps."""
    seen = view("up", seed)
    if abs(seen.yaw) < 0.1:
        pytest.skip("equation 7 is ill-conditioned when the camera faces the stairs")
    found = measure_stairs_as_the_paper(seen.lines, seen.depth, CAMERA, seen.gravity)
    assert found.direction == 1
    assert found.steps
    assert np.median(np.abs(seen.errors_mm(found)[:, 1])) < 20.0


@pytest.mark.parametrize("seed", SEEDS)
def test_missed_inner_edges_are_found_in_depth(seed: int) -> None:
    """Going up, a detector sees only the nosings: depth shows where tread turns into riser."""
    seen = view("up", seed)
    kinds = np.array(seen.measure().kinds)
    assert (kinds == "concave").sum() >= 2
    found = seen.measure(lines=seen.lines[kinds != "concave"])
    assert found.direction == 1
    assert len(found.steps) >= 1
    stds = 1000.0 * np.array([[step.width_std_m, step.height_std_m] for step in found.steps])
    assert (np.abs(seen.errors_mm(found)[:, :2]) < np.maximum(5.0, 3.0 * stds)).all()


def risers_alone(seen: View, fattened_px: int) -> np.ndarray:
    """Depth of the risers alone, each going on over its upper end by half a matcher's window."""
    v, u = np.indices(seen.depth.shape)
    rays = np.stack([(u + 0.5 - CAMERA.cx) / CAMERA.fx, (v + 0.5 - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    x = seen.depth * (rays @ seen.pose[0, :3]) + seen.distance_x
    away = np.abs(x[..., None] - seen.profile.edge_x).min(axis=-1)
    depth = np.where((away < 0.004) & (seen.depth > 0.0), seen.depth, 0.0)
    fattened = depth.copy()
    for shift in range(1, fattened_px + 1):
        above = np.zeros_like(depth)
        above[:-shift] = depth[shift:]
        fattened = np.where(fattened > 0.0, fattened, above)
    return fattened


@pytest.mark.parametrize("fattened_px", [0, 8])
@pytest.mark.parametrize("seed", SEEDS)
def test_steps_are_read_from_risers_alone(seed: int, fattened_px: int) -> None:
    seen = view("up", seed)
    found = seen.measure(depth=risers_alone(seen, fattened_px))
    assert found.direction == 1
    assert len(found.steps) >= 2
    assert (np.abs(seen.errors_mm(found)[:, :2]) < (6.0, 12.0)).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_risers_that_end_where_no_line_is_seen_end_for_other_reasons(seed: int) -> None:
    """Depth shows several risers, the detector one line: no step."""
    seen = view("up", seed)
    depth = risers_alone(seen, 0)
    lowest = seen.lines[np.argmax(seen.lines[:, 1])]
    found = seen.measure(depth=depth, lines=lowest[None])
    assert not found.steps
