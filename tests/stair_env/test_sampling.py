import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stair_env.common.validation import SpecError
from stair_env.sampling import Scene, SceneSampler, SceneSpec, sample_camera_pose
from stair_env.scene.appearance import AppearanceSpec, NosingStrip
from stair_env.scene.objects.distractors import FLAT_KINDS, DistractorSpec
from stair_env.scene.objects.fittings import FittingsSpec, build_fittings
from stair_env.scene.random_distractors import ON_FLIGHT_KINDS
from stair_env.scene.surroundings import SurroundingsSpec, build_surroundings, enclosure
from stair_env.scene.viewpoints import CLEARANCE_M, count_edges_in_view, min_clearance
from stair_env.stairs import StairSpec

seeds = st.integers(0, 2**32 - 1)
MIXED = SceneSampler(negatives=0.25, clutter=0.3)


@settings(max_examples=150, deadline=None)
@given(seeds)
def test_scene_survives_json_and_rebuilds_the_same_solids(seed):
    spec = MIXED.sample(np.random.default_rng(seed))
    again = SceneSpec.from_json(spec.to_json())
    assert again == spec
    assert Scene(again).shapes == Scene(spec).shapes


@settings(max_examples=100, deadline=None)
@given(seeds)
def test_same_seed_same_scene(seed):
    assert MIXED.sample(np.random.default_rng(seed)) == MIXED.sample(np.random.default_rng(seed))


@settings(max_examples=150, deadline=None)
@given(seeds)
def test_shapes_are_finite_solid_and_have_a_look(seed):
    scene = Scene(MIXED.sample(np.random.default_rng(seed)))
    for shape in scene.shapes:
        assert np.isfinite([*shape.position, *shape.size, *shape.orientation]).all()
        assert min(shape.size[: {"box": 3, "sphere": 1}.get(shape.kind, 2)]) > 0.0
        scene.spec.appearance.look(shape.surface)


@settings(max_examples=150, deadline=None)
@given(seeds)
def test_values_lie_in_the_asked_ranges(seed):
    sampler = SceneSampler((0.1, 0.12), 0.3, (3, 5), direction="both", lighting="night")
    spec = sampler.sample(np.random.default_rng(seed))
    assert 0.1 <= spec.stairs.riser_height <= 0.12
    assert spec.stairs.tread_depth == 0.3
    assert 3 <= spec.stairs.num_steps <= 5
    assert spec.stairs.direction in ("up", "down")
    assert spec.appearance.lighting == "night"


@settings(max_examples=100, deadline=None)
@given(seeds)
def test_solid_distractors_and_walls_leave_the_way_free(seed):
    spec = SceneSampler().sample(np.random.default_rng(seed))
    profile, half = spec.stairs.profile(), spec.stairs.flight_width / 2
    around = [shape for thing in spec.distractors for shape in thing.shapes if shape.collides]
    around += [shape for shape in build_surroundings(spec.surroundings, spec.stairs) if shape.surface != "floor"]
    for x in np.linspace(-2.0, float(profile.edge_x[-1]) + 0.8, 25) if around else ():
        for y in (-0.8 * half, 0.0, 0.8 * half):
            trunk = np.array([x, y, float(profile.height_at(x)) + 0.3])
            assert min_clearance(tuple(around), trunk) > 0.02


@settings(max_examples=60, deadline=None)
@given(seeds)
def test_fittings_leave_room_to_walk(seed):
    spec = SceneSampler(clutter=0.5).sample(np.random.default_rng(seed))
    shapes = build_fittings(spec.fittings, spec.stairs)
    assert not any(shape.collides for shape in shapes)
    solid = tuple(shape for shape in shapes if "runner" not in shape.surface)
    profile, half = spec.stairs.profile(), spec.stairs.flight_width / 2
    for x in np.linspace(-1.0, float(profile.edge_x[-1]) + 0.5, 20) if solid else ():
        for y in (-0.5 * half, 0.0, 0.5 * half):
            assert min_clearance(solid, np.array([x, y, float(profile.height_at(x)) + 0.4])) > 0.02


def test_clutter_stands_on_what_carries_it_and_only_where_asked_for():
    rng = np.random.default_rng(5)
    for _ in range(60):
        spec = SceneSampler(clutter=1.0).sample(rng)
        profile, half = spec.stairs.profile(), spec.stairs.flight_width / 2
        on_flight = [
            thing for thing in spec.distractors
            if abs(thing.position[1]) < half and -1.3 < thing.position[0] < profile.edge_x[-1] + 0.7
            and thing.kind in ON_FLIGHT_KINDS
        ]  # fmt: skip
        assert on_flight
        for thing in on_flight:
            assert thing.position[2] == pytest.approx(float(profile.height_at(thing.position[0])))


@settings(max_examples=100, deadline=None)
@given(seeds)
def test_paint_lies_beside_the_flight_not_on_it(seed):
    spec = SceneSampler().sample(np.random.default_rng(seed))
    last = float(spec.stairs.profile().edge_x[-1])
    for distractor in spec.distractors:
        if distractor.kind in FLAT_KINDS:
            assert distractor.position[0] < 0.0 or distractor.position[0] > last


@settings(max_examples=100, deadline=None)
@given(seeds)
def test_no_lens_inside_a_solid(seed):
    rng = np.random.default_rng(seed)
    spec = MIXED.sample(rng)
    pose = sample_camera_pose(spec, rng)
    assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3))
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    assert min_clearance(Scene(spec).shapes, pose[:3, 3]) >= CLEARANCE_M


def test_most_viewpoints_see_stairs_and_look_forward_and_down():
    rng = np.random.default_rng(1)
    sampler, seen, forward, pitch = SceneSampler(), [], [], []
    for _ in range(150):
        spec = sampler.sample(rng)
        pose = sample_camera_pose(spec, rng)
        seen.append(count_edges_in_view(spec.stairs, pose))
        forward.append(pose[0, 2])
        pitch.append(math.degrees(-math.asin(pose[2, 2])))
    assert np.mean(np.array(seen) >= 2) > 0.9
    assert min(forward) > 0.15
    assert min(pitch) > -30.0 and max(pitch) < 80.0
    assert 10.0 < np.mean(pitch) < 35.0


def test_a_robot_looks_forward_and_down():
    rng = np.random.default_rng(1)
    for _ in range(40):
        pose = sample_camera_pose(SceneSampler().sample(rng), rng, robot_share=1.0)
        assert pose[0, 2] > 0.4
        assert -15.0 < math.degrees(-math.asin(pose[2, 2])) < 60.0


def test_long_flights_are_seen_whole_and_from_beside():
    rng = np.random.default_rng(2)
    sampler = SceneSampler(num_steps=12, direction="up", tread_depth=(0.25, 0.3))
    many, across = 0, 0
    for _ in range(60):
        spec = sampler.sample(rng)
        pose = sample_camera_pose(spec, rng, robot_share=0.0)
        many += count_edges_in_view(spec.stairs, pose) >= 10
        across += abs(pose[1, 3]) > spec.stairs.flight_width / 2 + 0.2
    assert many >= 10
    assert across >= 2


def test_flights_down_are_often_looked_over():
    """From too low, a nosing hides all that follow; who holds the camera often looks over several."""
    rng = np.random.default_rng(4)
    sampler = SceneSampler(num_steps=6, direction="down")
    seen = {share: [] for share in (0.0, 1.0)}
    for _ in range(60):
        spec = sampler.sample(rng)
        for share, counts in seen.items():
            counts.append(count_edges_in_view(spec.stairs, sample_camera_pose(spec, rng, robot_share=share)))
    several = {share: np.mean(np.array(counts) >= 4) for share, counts in seen.items()}
    assert several[0.0] > 0.4 and several[0.0] > several[1.0]


def test_without_stairs_a_look_alike_is_mostly_in_view():
    rng = np.random.default_rng(3)
    found = []
    for _ in range(60):
        spec = SceneSampler(negatives=1.0).sample(rng)
        pose = sample_camera_pose(spec, rng)
        points = [np.array(thing.position) - pose[:3, 3] for thing in spec.distractors]
        found.append(any(point @ pose[:3, 2] > 0.5 * np.linalg.norm(point) for point in points))
    assert np.mean(found) > 0.7


def test_same_seed_same_viewpoint():
    spec = SceneSampler().sample(np.random.default_rng(4))
    poses = [sample_camera_pose(spec, np.random.default_rng(9)) for _ in range(2)]
    assert np.array_equal(*poses)


def test_every_variation_turns_up():
    rng = np.random.default_rng(0)
    specs = [MIXED.sample(rng) for _ in range(400)]
    stairs = [spec.stairs for spec in specs if spec.stairs is not None]
    looks = [spec.appearance for spec in specs]
    assert 0.15 < sum(spec.is_negative for spec in specs) / 400 < 0.35
    assert {s.direction for s in stairs} == {"up", "down", "up_down"}
    for share in (
        np.mean([bool(s.riser_offsets) for s in stairs]),
        np.mean([s.nosing_overhang > 0 for s in stairs]),
        np.mean([s.open_risers for s in stairs]),
        np.mean([s.handrails for s in stairs]),
        np.mean([s.stringers for s in stairs]),
        np.mean([s.side_walls != "none" for s in stairs]),
        np.mean([look.nosing_strip is not None for look in looks]),
        np.mean([look.lighting == "night" for look in looks]),
        np.mean([look.shadows for look in looks]),
        np.mean([look.tread == look.riser for look in looks]),
        np.mean([look.lamp_position is not None for look in looks]),
    ):
        assert 0.03 < share < 0.97
    assert {look.tread.material for look in looks} >= {"concrete", "terrazzo", "wood", "tile", "metal", "carpet"}


@pytest.mark.parametrize("strip", [NosingStrip(), NosingStrip(setback_m=0.02)])
@pytest.mark.parametrize("direction", ["up", "down", "up_down"])
def test_nosing_strips_lie_on_their_treads_and_do_not_collide(direction, strip):
    stairs = StairSpec(direction=direction)
    scene = Scene(SceneSpec(stairs, AppearanceSpec(nosing_strip=strip)))
    strips = [shape for shape in scene.shapes if shape.surface == "nosing"]
    assert len(strips) == sum(edge.kind == "convex" for edge in scene.edges)
    for shape in strips:
        top = shape.position[2] + shape.size[2]
        assert top == pytest.approx(float(stairs.profile().height_at(shape.position[0])), abs=0.002)
        assert not shape.collides


def test_strips_come_in_kinds():
    stairs = StairSpec(num_steps=5)

    def strips(**fields):
        shapes = Scene(SceneSpec(stairs, AppearanceSpec(nosing_strip=NosingStrip(**fields)))).shapes
        return [shape for shape in shapes if shape.surface == "nosing"]

    whole = strips()
    assert len(strips(lines=2)) == 2 * len(whole)
    assert len(strips(ends_only=True)) == 2
    assert strips(missing=1.0) == []
    length = sum(shape.size[1] for shape in whole)
    assert 0.2 * length < sum(shape.size[1] for shape in strips(missing=0.5, seed=3)) < 0.9 * length
    assert all(shape.size[1] == pytest.approx(stairs.flight_width / 2 - 0.1) for shape in strips(inset_m=0.1))
    assert strips(drop_m=0.04)[0].size[2] > whole[0].size[2]


def test_an_old_scene_without_fittings_loads():
    spec = SceneSampler().sample(np.random.default_rng(0))
    values = json.loads(spec.to_json())
    del values["fittings"]
    assert SceneSpec.from_json(json.dumps(values)) == dataclasses.replace(spec, fittings=None)


@pytest.mark.parametrize("direction", ["up", "down", "up_down"])
@pytest.mark.parametrize("railing", ["bars", "cross_bars", "panel"])
def test_fittings_follow_the_slope(direction, railing):
    stairs = StairSpec(direction=direction, num_steps=5)
    spec = FittingsSpec(
        railing=railing, railing_sides="left", wall_sides="right", wall_rail=True, skirting=True, runner=0.6
    )
    shapes = build_fittings(spec, stairs)
    profile = stairs.profile()
    rails = [shape for shape in shapes if (shape.surface == "rail" and shape.size[0] > 0.1) or shape.kind == "cylinder"]
    assert len(rails) == 2 * (2 if direction == "up_down" else 1)
    for rail in rails:
        assert 0.7 < rail.position[2] - float(profile.height_at(rail.position[0])) < 1.15
    runner = [shape for shape in shapes if "runner" in shape.surface]
    assert max(shape.size[1] for shape in runner) == pytest.approx(0.6 * stairs.flight_width / 2)
    for shape in runner:
        top = shape.position[2] + shape.size[2]
        heights = [float(profile.height_at(shape.position[0] + dx)) for dx in (-0.02, 0.0, 0.02)]
        assert min(abs(top - height) for height in heights) < 0.005


def test_a_landing_does_not_end_in_a_drop():
    stairs = StairSpec(direction="up")
    for kind in ("plain", "indoor", "outdoor"):
        scene = Scene(SceneSpec(stairs, surroundings=SurroundingsSpec(kind)))
        end = float(stairs.profile().edge_x[-1]) + stairs.landing_depth
        under = np.array([end + 0.01, 0.0, stairs.total_height - 0.05])
        assert min_clearance(scene.shapes, under) < 0.0


def test_rooms_enclose_the_flight():
    stairs = StairSpec()
    room = enclosure(SurroundingsSpec("indoor"), stairs)
    assert room.y_left >= stairs.flight_width / 2 and room.y_right <= -stairs.flight_width / 2
    assert room.x_high >= stairs.profile().edge_x[-1] + stairs.landing_depth
    assert room.z_top > stairs.total_height


def test_a_scene_without_stairs_has_a_floor_and_no_edges():
    scene = Scene(SceneSpec(None))
    assert scene.edges == ()
    assert {shape.surface for shape in scene.shapes} == {"floor"}


def test_scene_begins_with_the_stairs_and_ends_with_the_distractors():
    spec = SceneSpec(StairSpec(), distractors=(DistractorSpec("bench", (0.0, 3.0, 0.0)),))
    surfaces = [shape.surface for shape in Scene(spec).shapes]
    assert surfaces[0] == "floor"
    assert surfaces[-1].startswith("distractor:bench")


@pytest.mark.parametrize(
    "field, value",
    [
        ("riser_height", (0.2, 0.1)),
        ("riser_height", -1.0),
        ("riser_height", (0.1, 0.2, 0.3)),
        ("tread_depth", math.nan),
        ("num_steps", 0),
        ("num_steps", 2.5),
        ("direction", "sideways"),
        ("lighting", "dusk"),
        ("negatives", 1.5),
    ],
)
def test_bad_arguments_are_named(field, value):
    with pytest.raises(SpecError, match=field):
        SceneSampler(**{field: value})


@pytest.mark.parametrize("text", ["", "3", '{"stairs": {"steps": 1}}', '{"appearance": 1}', '{"stars": {}}'])
def test_bad_json_is_refused(text):
    with pytest.raises(SpecError):
        SceneSpec.from_json(text)
