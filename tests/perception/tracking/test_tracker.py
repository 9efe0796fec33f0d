"""The tracker against a robot that walks along a known staircase, seen through noisy, late, missing frames."""

from __future__ import annotations

import dataclasses
import math
import time

import numpy as np
import pytest

from perception.geometry.results import Nosing, StairEstimate, StepMeasurement
from perception.tracking.tracker import (
    CameraPlacement,
    StairTracker,
    TrackerConfig,
    place_camera,
)
from stair_env.common.validation import SpecError
from stair_env.observation import NO_STAIRS, StairBlock
from stair_env.robots import ROBOTS, mount_to_base
from stair_env.stairs import StairProfile, StairSpec

HIP = 0.24
CAMERA = CameraPlacement(0.34, 0.0, 0.0)
DT = 1.0 / 48.0
LATENCY = 0.1


def look(
    profile: StairProfile, base_x: float, yaw: float, rng: np.random.Generator, noise: float = 1.0
) -> StairEstimate:
    """What an estimator would say of the next three nosings that lie 0.35 m or more ahead of the camera."""
    camera_x = base_x + CAMERA.forward_m * math.cos(yaw)
    direction = int(np.sign(profile.rises[np.argmax(profile.edge_x > base_x)]))
    nosings = []
    for i, x in enumerate(profile.edge_x):
        ahead = x - camera_x
        if not 0.35 < ahead < 2.2 or len(nosings) == 3 or np.sign(profile.rises[i]) != direction:
            continue
        run = float(np.diff(profile.edge_x)[i]) if i + 1 < len(profile.edge_x) else None
        riser = abs(float(profile.rises[i])) + noise * rng.normal(0, 0.003)
        tread = run + noise * rng.normal(0, 0.005) if run is not None else None
        nosings.append(
            Nosing(
                ahead + noise * rng.normal(0, 0.006), 0.006, 0.0, 0.005, riser, 0.003, tread, 0.005 if tread else None
            )
        )
    valid = bool(nosings)
    # The camera looks to the left of the walking direction by yaw, so its yaw_rad is -yaw.
    return StairEstimate(
        valid=valid,
        direction=direction if valid else 0,
        nosings=tuple(nosings),
        steps=tuple(StepMeasurement(n.tread_m, n.riser_m, 0.0, 0.0, n.distance_m) for n in nosings if n.tread_m),
        yaw_rad=-yaw + noise * rng.normal(0, 0.01),
        yaw_std_rad=0.01,
        next_edge_m=nosings[0].distance_m if nosings else 0.0,
    )


class Walk:
    """A base that walks along x with a heading, and what the tracker makes of it."""

    def __init__(
        self, spec: StairSpec, *, seed: int = 0, drift: float = 0.03, drop: float = 0.1, yaw: float = 0.1
    ) -> None:
        self.profile, self.rng = spec.profile(), np.random.default_rng(seed)
        self.drift, self.drop, self.yaw = drift, drop, yaw
        self.tracker = StairTracker(HIP)
        self.x, self.time, self.next_frame = -1.8, 0.0, 0.0
        self.pending: list[tuple[float, StairEstimate]] = []
        self.tracker.reset(0.0)

    def truth(self) -> StairBlock:
        hip = self.x + HIP * math.cos(self.yaw)
        ahead = int(np.searchsorted(self.profile.edge_x, hip, side="right"))
        if ahead >= len(self.profile.edge_x):
            return NO_STAIRS
        runs = np.diff(self.profile.edge_x)
        return StairBlock(
            1.0,
            float(np.sign(self.profile.rises[ahead])),
            float(runs[min(ahead, len(runs) - 1)]),
            abs(float(self.profile.rises[ahead])),
            float(self.profile.edge_x[ahead]) - hip,
            -self.yaw,
        )

    def step(self, speed: float = 0.35, estimate: StairEstimate | None = None) -> StairBlock:
        self.x += speed * DT
        self.time += DT
        forward, left = speed * math.cos(self.yaw), -speed * math.sin(self.yaw)
        scale = 1.0 + self.drift
        self.tracker.advance(self.time, forward * scale, left * scale, 0.0)
        if self.time >= self.next_frame:
            self.next_frame += 1.0 / 15.0
            if self.rng.random() >= self.drop and self.x < self.profile.edge_x[-1]:
                seen = estimate or look(self.profile, self.x, self.yaw, self.rng)
                self.pending.append((self.time, seen))
        while self.pending and self.pending[0][0] + LATENCY <= self.time:
            captured, seen = self.pending.pop(0)
            self.tracker.observe(seen, captured, CAMERA)
        return self.tracker.block()


UNEVEN = (0.010, -0.008, 0.006, -0.010, 0.009, -0.004, 0.0)


def uneven(direction: str) -> StairSpec:
    return StairSpec(
        direction=direction,
        riser_height=0.15,
        tread_depth=0.29,
        num_steps=7,
        riser_offsets=UNEVEN,
        tread_offsets=UNEVEN[::-1],
    )


@pytest.mark.parametrize("direction", ["up", "down"])
def test_follows_every_step_of_an_uneven_flight(direction: str) -> None:
    walk = Walk(uneven(direction))
    errors = []
    valid = []
    while walk.x < walk.profile.edge_x[-1] - HIP:
        block, truth = walk.step(), walk.truth()
        if walk.x > -1.3 and truth.valid:
            valid.append(block.valid)
            if block.valid:
                assert block.direction == truth.direction
                errors.append(
                    [
                        block.step_width - truth.step_width,
                        block.step_height - truth.step_height,
                        block.edge_distance - truth.edge_distance,
                        block.heading_error - truth.heading_error,
                    ]
                )
    # An edge is passed a moment earlier or later than truly: then the block speaks of the neighbour.
    rows = np.array([e for e in errors if abs(e[2]) < 0.15])
    assert len(rows) > 0.97 * len(errors), len(errors) - len(rows)
    width, height, distance, heading = np.sqrt((rows**2).mean(axis=0))
    assert np.mean(valid) > 0.97
    assert width < 0.006
    assert height < 0.004
    assert distance < 0.015
    assert heading < 0.02


def test_uneven_risers_are_not_averaged_away() -> None:
    walk = Walk(uneven("up"))
    seen: dict[int, float] = {}
    while walk.x < walk.profile.edge_x[-1] - HIP:
        block = walk.step()
        ahead = int(np.searchsorted(walk.profile.edge_x, walk.x + HIP * math.cos(walk.yaw), side="right"))
        if block.valid and walk.truth().valid and abs(block.edge_distance - walk.truth().edge_distance) < 0.1:
            seen[ahead] = block.step_height
    measured = np.array([seen[i] for i in sorted(seen)])
    true = np.abs(walk.profile.rises[sorted(seen)])
    assert len(measured) >= 6
    assert np.abs(measured - true).max() < 0.005
    assert np.ptp(measured) > 0.015


def test_invalid_and_empty_before_anything_is_seen_and_after_the_last_edge() -> None:
    walk = Walk(uneven("up"))
    assert StairTracker(HIP).block() == NO_STAIRS
    while walk.x < walk.profile.edge_x[-1] + 0.3:
        block = walk.step()
    assert block == NO_STAIRS


def test_keeps_counting_through_a_blackout() -> None:
    walk = Walk(uneven("up"))
    while walk.x < -0.4:
        walk.step()
    walk.drop = 1.0
    edges = 0
    last = walk.tracker.block().edge_distance
    for _ in range(int(1.8 / DT)):  # 0.63 m, two treads, without a frame
        block = walk.step()
        assert block.valid == 1.0
        edges += block.edge_distance > last + 0.1
        last = block.edge_distance
        nosings = walk.profile.edge_x - walk.x - HIP * math.cos(walk.yaw)
        assert np.abs(nosings - block.edge_distance).min() < 0.04
    assert edges >= 1
    assert block.age > 1.5


def test_latency_is_compensated() -> None:
    """A late frame from a fast robot still gives the right distance."""
    walk = Walk(StairSpec(riser_height=0.12, tread_depth=0.3, num_steps=6), drift=0.0, drop=0.0, yaw=0.0)
    errors = []
    while walk.x < -0.3:
        block = walk.step(speed=0.8)
        if block.valid:
            errors.append(block.edge_distance - walk.truth().edge_distance)
    assert abs(np.mean(errors)) < 0.006  # 0.8 m/s times 0.1 s would be 0.08


def test_recovers_after_being_wrong() -> None:
    walk = Walk(uneven("up"), drop=0.0)
    wrong = look(StairSpec(direction="down").profile(), -1.0, 0.0, np.random.default_rng(1))
    for _ in range(15):
        walk.step(speed=0.0, estimate=wrong)
    assert walk.tracker.block().direction == -1.0
    for _ in range(40):
        block = walk.step(speed=0.35)
    assert block.direction == 1.0
    assert abs(block.edge_distance - walk.truth().edge_distance) < 0.03


def test_one_wrong_frame_changes_nothing() -> None:
    walk = Walk(uneven("up"), drop=0.0)
    while walk.x < -0.8:
        walk.step()
    wrong = look(StairSpec(direction="down").profile(), -1.0, 0.0, np.random.default_rng(1))
    before = walk.tracker.block()
    assert not walk.tracker.observe(wrong, walk.time, CAMERA)
    assert walk.tracker.block() == before


def test_forgets_a_staircase_left_behind() -> None:
    walk = Walk(uneven("up"), drop=0.0)
    while walk.x < -1.0:
        walk.step()
    walk.drop = 1.0
    for _ in range(int(3.5 / DT)):
        block = walk.step(speed=0.0)
    assert block == NO_STAIRS
    assert len(walk.tracker.nosings) == 0


def test_up_then_down_switches_direction_on_the_landing() -> None:
    spec = StairSpec(direction="up_down", riser_height=0.12, tread_depth=0.3, num_steps=3, landing_depth=1.6)
    walk = Walk(spec)
    directions = set()
    wrong = 0
    while walk.x < walk.profile.edge_x[-1] - HIP - 0.1:
        block, truth = walk.step(), walk.truth()
        if block.valid:
            directions.add(block.direction)
            wrong += block.direction != truth.direction
    assert directions == {1.0, -1.0}
    assert wrong < 8


@pytest.mark.parametrize("seed", range(20))
def test_random_frames_never_give_nan_or_leave_the_block(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tracker = StairTracker(HIP)
    now = 0.0
    for _ in range(300):
        now += DT
        tracker.advance(now, *rng.normal(0, 1, 2), rng.normal(0, 2))
        count = int(rng.integers(0, 6))
        nosings = tuple(
            Nosing(float(d), 0.01, 0.0, 0.01, float(rng.uniform(0.05, 0.3)), 0.0, float(rng.uniform(0.05, 0.6)), 0.0)
            for d in np.sort(rng.uniform(0.1, 4.0, count))
        )
        estimate = StairEstimate(
            valid=bool(count),
            direction=int(rng.choice([-1, 1])),
            nosings=nosings,
            yaw_rad=float(rng.uniform(-1.2, 1.2)),
        )
        tracker.observe(estimate, now - rng.uniform(0, 3), CAMERA)
        block = tracker.block().as_array()
        assert np.isfinite(block).all()
        assert block[0] in (0.0, 1.0)
        assert block[0] == 1.0 or not block.any()


def test_nan_odometry_is_ignored() -> None:
    tracker = StairTracker(HIP)
    tracker.advance(0.1, math.nan, 0.0, 0.0)
    tracker.observe(look(uneven("up").profile(), -1.0, 0.0, np.random.default_rng(0)), 0.1, CAMERA)
    tracker.advance(0.2, 0.3, 0.0, math.inf)
    assert np.isfinite(tracker.block().as_array()).all()


def test_camera_placement_follows_pitch_and_roll() -> None:
    robot = ROBOTS["aliengo"]
    mount = mount_to_base(robot.camera)
    level = place_camera(mount, mount[:3, :3].T @ np.array([0.0, 0.0, 9.8]))
    assert level.forward_m == pytest.approx(robot.camera.position[0])
    assert level.heading_rad == pytest.approx(0.0)
    pitch = math.radians(-20.0)  # nose up
    up_base = np.array([-math.sin(pitch), 0.0, math.cos(pitch)])
    nose_up = place_camera(mount, mount[:3, :3].T @ up_base)
    x, _, z = robot.camera.position
    assert nose_up.forward_m == pytest.approx(x * math.cos(pitch) + z * math.sin(pitch), abs=1e-9)
    assert nose_up.heading_rad == pytest.approx(0.0, abs=1e-9)


def test_a_phantom_far_behind_the_flight_is_not_the_next_edge() -> None:
    walk = Walk(uneven("up"), drop=0.0)
    while walk.x < -0.3:
        walk.step()
    seen = look(walk.profile, walk.x, walk.yaw, walk.rng)
    phantom = Nosing(3.2, 0.02, 0.0, 0.02)
    walk.step(estimate=dataclasses.replace(seen, nosings=(*seen.nosings, phantom)))
    while walk.x < walk.profile.edge_x[-1] - HIP + 0.15:
        block, truth = walk.step(), walk.truth()
        assert not block.valid or block.edge_distance < 0.45
    assert not truth.valid
    assert block == NO_STAIRS


@pytest.mark.parametrize(("edges", "gap_m"), [(1, 2.4), (2, 2.4), (1, 0.6)])
def test_beyond_the_landing_a_bench_is_no_stair_and_a_second_flight_is(edges: int, gap_m: float) -> None:
    """However often it was seen; next to the flight a lone riser may be its last, one nosing having been missed."""
    walk = Walk(uneven("up"), drop=0.0)
    last = float(walk.profile.edge_x[-1])
    beyond = last + gap_m + 0.3 * np.arange(edges)
    while walk.x < last - HIP + 0.1:
        seen = look(walk.profile, walk.x, walk.yaw, walk.rng)
        ahead = beyond - walk.x - CAMERA.forward_m * math.cos(walk.yaw)
        extra = (Nosing(float(x), 0.01, 0.0, 0.005, 0.19, 0.005, None, None) for x in ahead)
        block = walk.step(estimate=dataclasses.replace(seen, nosings=(*seen.nosings, *extra)))
    assert not walk.truth().valid
    if edges == 1 and gap_m > 2.0:
        assert block == NO_STAIRS
    else:
        assert block.edge_distance == pytest.approx(gap_m - 0.1, abs=0.1)
        assert block.step_height == pytest.approx(0.19, abs=0.01)


@pytest.mark.parametrize(("direction", "sign"), [("up", 1), ("down", -1)])
def test_edges_below_the_view_are_inferred_from_the_feet(direction: str, sign: int) -> None:
    """The first nosing in view is not the first one: the feet stand risers, uneven ones, away from its level."""
    riser, tread = 0.15, 0.3
    level = -0.45  # of the ground before the first nosing in view, relative to the camera
    nosing = Nosing(0.7, 0.005, level + (riser if sign > 0 else 0.0), 0.005, riser, 0.003, tread, 0.004)
    estimate = StairEstimate(True, sign, nosings=(nosing,))
    for hidden, rise in ((0, 0.0), (1, 0.114), (1, 0.16), (2, 0.27)):
        tracker = StairTracker(HIP)
        tracker.observe(estimate, 0.0, CameraPlacement(HIP, 0.0, 0.0, ground_m=level - sign * rise))
        block = tracker.block()
        assert block.edge_distance == pytest.approx(0.7 - hidden * tread, abs=1e-6)
        assert block.step_height == pytest.approx(rise / hidden if hidden else riser, abs=1e-6)


def test_a_riser_whose_foot_is_out_of_view_is_felt() -> None:
    """Close to the stairs the picture begins at the first nosing: its riser is what the soles stand below it."""
    riser, felt, tread = 0.15, 0.114, 0.3
    first = Nosing(0.25, 0.005, -0.3, 0.005, None, None, tread, 0.004)
    second = Nosing(0.25 + tread, 0.005, -0.3 + riser, 0.005, riser, 0.003, tread, 0.004)
    tracker = StairTracker(HIP)
    tracker.observe(
        StairEstimate(True, 1, nosings=(first, second)), 0.0, CameraPlacement(HIP, 0.0, 0.0, ground_m=-0.3 - felt)
    )
    block = tracker.block()
    assert (block.edge_distance, block.step_height) == pytest.approx((0.25, felt), abs=1e-6)


def test_step_is_cheap() -> None:
    walk = Walk(uneven("up"), drop=0.0)
    for _ in range(100):
        walk.step(speed=0.1)
    start = time.perf_counter()
    for _ in range(200):
        walk.tracker.advance(walk.time, 0.0, 0.0, 0.0)
        walk.tracker.block()
    assert (time.perf_counter() - start) / 200 < 2e-3  # aim 0.3 ms; the margin is for a busy machine


def test_config_names_the_wrong_field() -> None:
    with pytest.raises(SpecError, match="max_age_s"):
        TrackerConfig(max_age_s=-1.0)


def lone_riser(direction: int, distance_m: float) -> StairEstimate:
    nosing = Nosing(distance_m, 0.005, -0.4, 0.005, 0.12, 0.003)
    return StairEstimate(valid=True, direction=direction, nosings=(nosing,), next_edge_m=distance_m)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_riser_alone_starts_no_staircase(direction: int) -> None:
    """A kerb, a box or a skirting board shows one too."""
    tracker = StairTracker(HIP)
    tracker.reset(0.0)
    for frame in range(10):
        tracker.advance(0.1 * (frame + 1), 0.0, 0.0, 0.0)
        assert not tracker.observe(lone_riser(direction, 0.8), 0.1 * frame, CAMERA)
    assert tracker.block() == NO_STAIRS


def test_the_last_riser_of_a_known_staircase_still_counts() -> None:
    rng = np.random.default_rng(0)
    profile = StairSpec(riser_height=0.12, tread_depth=0.3, num_steps=3).profile()
    tracker = StairTracker(HIP)
    tracker.reset(0.0)
    tracker.advance(0.1, 0.0, 0.0, 0.0)
    assert tracker.observe(look(profile, -1.0, 0.0, rng, noise=0.0), 0.1, CAMERA)
    last = float(profile.edge_x[-1]) + 1.0 - CAMERA.forward_m
    assert tracker.observe(lone_riser(1, last), 0.1, CAMERA)
