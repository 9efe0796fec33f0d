import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stair_env.common.validation import SpecError
from stair_env.scene.shapes import build_stair_shapes
from stair_env.scene.surroundings import (
    SURROUNDINGS_KINDS,
    WINDOW_SIDES,
    SurroundingsSpec,
    build_surroundings,
    enclosure,
)
from stair_env.scene.viewpoints import min_clearance
from stair_env.stairs import StairSpec

gaps = st.floats(0.0, 6.0)
specs = st.builds(
    SurroundingsSpec,
    kind=st.sampled_from(SURROUNDINGS_KINDS),
    back_gap=gaps,
    left_gap=gaps,
    right_gap=gaps,
    headroom=st.floats(2.0, 6.0),
    window=st.sampled_from(WINDOW_SIDES),
    panels=st.integers(0, 6),
    seed=st.integers(0, 2**31 - 2),
)
flights = st.none() | st.builds(
    StairSpec, direction=st.sampled_from(["up", "down", "up_down"]), num_steps=st.integers(1, 12)
)


@settings(max_examples=200, deadline=None)
@given(specs, flights)
def test_solids_have_extent_and_leave_the_flight_free(spec, stairs):
    shapes = build_surroundings(spec, stairs)
    for shape in shapes:
        assert np.isfinite([*shape.position, *shape.size]).all()
        assert min(shape.size) > 0.0
    if stairs is None:
        return
    profile = stairs.profile()
    for x in np.linspace(-2.0, float(profile.edge_x[-1]) + 0.5, 12):
        above_walking_level = np.array([x, 0.0, float(profile.height_at(x)) + 0.3])
        assert min_clearance(shapes, above_walking_level) > 0.05


@settings(max_examples=20, deadline=None)
@given(specs)
def test_sun_reaches_a_room_only_through_its_window(spec):
    stairs = StairSpec(num_steps=4)
    spec = SurroundingsSpec(**{**{f: getattr(spec, f) for f in spec.__dataclass_fields__}, "kind": "indoor"})
    room = enclosure(spec, stairs)
    shapes = tuple(s for s in build_surroundings(spec, stairs) if s.surface in ("wall", "rail"))
    for side, y in (("left", room.y_left + 0.05), ("right", room.y_right - 0.05)):
        xs, zs = np.linspace(-2.0, room.x_high - 0.05, 30), np.linspace(0.1, room.z_top - 0.05, 12)
        inside_wall = [min_clearance(shapes, np.array([x, y, z])) < 0.0 for x in xs for z in zs]
        assert all(inside_wall) == (spec.window != side)


def test_a_room_is_closed_above_and_behind():
    stairs = StairSpec()
    spec = SurroundingsSpec("indoor")
    room, shapes = enclosure(spec, stairs), build_surroundings(spec, stairs)
    for point in ([0.5, 0.0, room.z_top + 0.05], [room.x_high + 0.05, 0.0, 1.0], [room.x_low - 0.05, 0.0, 1.0]):
        assert min_clearance(shapes, np.array(point)) < 0.0


def test_ground_goes_on_outdoors_below_the_floor_of_the_stairs():
    stairs = StairSpec()
    shapes = build_surroundings(SurroundingsSpec("outdoor"), stairs)
    far_off = np.array([-30.0, 20.0, 0.0])
    assert 0.0 < min_clearance(shapes, far_off) < 0.01
    assert min_clearance(build_stair_shapes(stairs), far_off) > 5.0


@pytest.mark.parametrize(
    "field, value",
    [
        ("kind", "moon"),
        ("window", "roof"),
        ("back_gap", -1.0),
        ("headroom", math.nan),
        ("panels", 99),
        ("left_gap", 7.0),
    ],
)
def test_bad_values_are_named(field, value):
    with pytest.raises(SpecError, match=field):
        SurroundingsSpec(**{field: value})
