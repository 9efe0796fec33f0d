"""The cross-section from depth, and the detector's lines against it, on rendered staircases of known size."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from perception.geometry.line_matching import CheckedLines, check_lines
from perception.geometry.planes import camera_to_level, level_to_stair
from perception.geometry.profile.depth_profile import Profile, read_profile
from perception.geometry.strips.strip_labels import RISER, TREAD
from stair_env.common.transforms import look_along
from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.labels import visible_edges
from stair_env.sensors.camera.renderers.factory import make_renderer
from stair_env.stairs import StairSpec

CAMERA = D435I_COLOR_MODES["640x480"]
RISER_M, TREAD_M = 0.16, 0.30
DISTANCE_M = 0.9
WIDE = (-0.4, 0.4)
OMEGA_M = 0.05
DEGREES = (-15.0, 0.0, 12.0)


class Seen:
    """A staircase from in front of it, with exact depth."""

    def __init__(self, direction: str, yaw_rad: float) -> None:
        spec = StairSpec(direction=direction, riser_height=RISER_M, tread_depth=TREAD_M, num_steps=5)  # type: ignore[arg-type]
        scene = Scene(SceneSpec(spec))
        height = 0.7 if direction == "up" else 1.1
        floor = float(spec.profile().level_z[0])
        sign = 1.0 if direction == "up" else -1.0
        pitch = math.atan2(height - sign * 0.2, DISTANCE_M + 0.4)
        position = np.array([-DISTANCE_M, -DISTANCE_M * math.tan(yaw_rad), floor + height])
        pose = look_along(position, yaw_rad, pitch, 0.0)
        renderer = make_renderer("raycast", scene)
        frame = renderer.render(CAMERA, pose)
        renderer.close()
        self.depth = frame.depth_m
        self.camera_to_stair = level_to_stair(-yaw_rad) @ camera_to_level(9.8 * pose[2, :3])
        rows = []
        for label in visible_edges(scene.edges, CAMERA, pose, frame):
            k = (label.y2 - label.y1) / (label.x2 - label.x1)
            rows.append([label.x1, label.y1, label.x2, label.y2, k, label.y1 - k * label.x1, 1.0, 10.0])
        self.lines = np.array(rows)
        self.kinds = [label.kind for label in visible_edges(scene.edges, CAMERA, pose, frame)]
        self.eye = height

    def profile(self) -> Profile:
        return read_profile(self.depth, CAMERA, self.camera_to_stair, 320.0, WIDE, OMEGA_M)

    def check(self, lines: np.ndarray) -> CheckedLines:
        return check_lines(lines, self.depth, CAMERA, self.camera_to_stair, OMEGA_M, 2)


@functools.cache
def seen(direction: str, degrees: float) -> Seen:
    return Seen(direction, math.radians(degrees))


@pytest.mark.parametrize("degrees", DEGREES)
def test_going_up_treads_and_risers_take_turns_at_their_true_places(degrees: float) -> None:
    view = seen("up", degrees)
    profile = view.profile()
    risers, treads = profile.value[profile.kind == RISER], profile.value[profile.kind == TREAD]
    assert len(risers) >= 3
    count = len(risers)
    assert risers[:3] == pytest.approx(DISTANCE_M + TREAD_M * np.arange(count)[:3], abs=2e-3)
    assert treads[:3] == pytest.approx(RISER_M * np.arange(3) - view.eye, abs=2e-3)
    assert (np.diff(profile.kind[:5]) != 0).all()


@pytest.mark.parametrize("degrees", DEGREES)
def test_going_down_every_tread_is_one_riser_lower(degrees: float) -> None:
    profile = seen("down", degrees).profile()
    treads = profile.value[profile.kind == TREAD]
    assert len(treads) >= 3
    assert np.diff(treads[:3]) == pytest.approx([-RISER_M] * 2, abs=2e-3)
    drops = [edge for edge in profile.edges if edge.near_kind == TREAD and edge.far_kind == TREAD]
    assert drops[0].forward_m == pytest.approx(DISTANCE_M, abs=0.01)


def test_nothing_is_seen_without_depth() -> None:
    view = seen("up", 0.0)
    profile = read_profile(np.zeros_like(view.depth), CAMERA, view.camera_to_stair, 320.0, WIDE, OMEGA_M)
    assert profile.edges == ()
    assert len(profile.kind) == 0
    assert (profile.face == -1).all()


@pytest.mark.parametrize("degrees", DEGREES)
@pytest.mark.parametrize("direction", ["up", "down"])
def test_true_lines_are_all_confirmed(direction: str, degrees: float) -> None:
    view = seen(direction, degrees)
    nearest = view.lines[np.argsort(-(view.lines[:, 1] + view.lines[:, 3]))][:4]
    checked = view.check(nearest)
    assert set(checked.source[checked.confirmed]) == set(range(len(nearest)))


@pytest.mark.parametrize("degrees", DEGREES)
def test_lines_that_the_detector_missed_are_drawn(degrees: float) -> None:
    view = seen("up", degrees)
    nosings = view.lines[np.array(view.kinds) == "convex"]
    inner = view.lines[np.array(view.kinds) == "concave"]
    checked = view.check(nosings)
    added = checked.lines[checked.source < 0]
    x = inner[:, [0, 2]].mean(axis=1)
    y = inner[:, 4] * x + inner[:, 5]
    miss = np.abs(added[:, 4:5] * x + added[:, 5:6] - y).min(axis=0)
    assert (miss < 2.5).sum() >= 3
    assert (added[:, 6] == 0.0).all()


@pytest.mark.parametrize("direction", ["up", "down"])
def test_a_line_in_the_middle_of_a_face_is_left_out(direction: str) -> None:
    view = seen(direction, 0.0)
    lowest = view.lines[np.argmax(view.lines[:, 1])]
    painted = lowest.copy()
    painted[[1, 3, 5]] += 25.0  # on the floor before the first edge
    checked = view.check(np.concatenate([view.lines, painted[None]]))
    assert len(view.lines) not in checked.source


def test_pieces_of_one_edge_become_one_line_over_its_whole_width() -> None:
    view = seen("up", 0.0)
    nosing = view.lines[np.array(view.kinds) == "convex"][0]
    pieces = np.stack([nosing, nosing])
    third = (nosing[2] - nosing[0]) / 3.0
    pieces[0, 2], pieces[1, 0] = nosing[0] + third, nosing[2] - third
    pieces[:, 7] = 3.0
    others = view.lines[np.array(view.kinds) == "concave"]
    checked = view.check(np.concatenate([pieces, others]))
    found = checked.lines[np.isin(checked.source, (0, 1))]
    assert len(found) == 1
    assert found[0, 2] - found[0, 0] > 2.5 * third
    assert found[0, 7] == 6.0


@pytest.mark.parametrize("seed", range(10))
def test_random_lines_over_random_depth_never_fail(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lines = rng.uniform(0.0, 480.0, (5, 8))
    lines[:, 2] = lines[:, 0] + rng.uniform(1.0, 300.0, 5)
    lines[:, 4] = rng.uniform(-3.0, 3.0, 5)
    lines[:, 6:] = 1.0, 3.0
    depth = (rng.random((480, 640)) * rng.choice([0.0, 0.3, 4.0])).astype(np.float32)
    checked = check_lines(lines, depth, CAMERA, level_to_stair(0.1) @ camera_to_level(rng.normal(size=3)), OMEGA_M, 2)
    assert np.isfinite(checked.lines).all()
    assert len(checked.lines) == len(checked.source) == len(checked.own_length) == len(checked.confirmed)
