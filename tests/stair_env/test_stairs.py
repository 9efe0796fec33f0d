import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stair_env.common.validation import SpecError
from stair_env.stairs import StairSpec

specs = st.builds(
    StairSpec,
    direction=st.sampled_from(["up", "down", "up_down"]),
    riser_height=st.floats(0.05, 0.20),
    tread_depth=st.floats(0.22, 0.40),
    num_steps=st.integers(1, 12),
    nosing_overhang=st.floats(0.0, 0.03),
    open_risers=st.booleans(),
    side_walls=st.sampled_from(["none", "left", "right", "both"]),
)


@given(specs)
def test_json_round_trip(spec):
    assert StairSpec.from_json(spec.to_json()) == spec


@given(specs)
def test_profile_climbs_by_the_risers(spec):
    profile = spec.profile()
    flights = 2 if spec.direction == "up_down" else 1
    assert len(profile.edge_x) == flights * spec.num_steps
    assert np.all(np.diff(profile.edge_x) > 0)
    assert np.allclose(np.abs(profile.rises), spec.riser_height)
    assert profile.level_z.min() == pytest.approx(0.0, abs=1e-12)
    assert profile.level_z.max() == pytest.approx(spec.total_height)


@given(specs, st.floats(-2, 6))
def test_height_is_the_number_of_edges_behind(spec, x):
    profile = spec.profile()
    expected = profile.level_z[0] + profile.rises[profile.edge_x <= x].sum()
    assert profile.height_at(x) == pytest.approx(expected)


@given(specs)
def test_every_transition_has_a_nosing_on_its_higher_side(spec):
    nosings = [edge for edge in spec.edges() if edge.kind == "convex"]
    profile = spec.profile()
    assert [edge.x for edge in nosings] == pytest.approx(list(profile.edge_x))
    highs = np.maximum(profile.level_z[:-1], profile.level_z[1:])
    assert [edge.z for edge in nosings] == pytest.approx(list(highs))
    inner = [edge for edge in spec.edges() if edge.kind == "concave"]
    assert len(inner) == (0 if spec.open_risers else len(nosings))


def test_offsets_move_single_steps():
    spec = StairSpec(num_steps=3, riser_offsets=(0.01, 0.0, -0.01), tread_offsets=(0.0, 0.02, 0.0))
    assert spec.profile().rises == pytest.approx([0.16, 0.15, 0.14])
    assert np.diff(spec.profile().edge_x) == pytest.approx([0.30, 0.32])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("riser_height", -1.0),
        ("riser_height", math.nan),
        ("riser_height", "tall"),
        ("tread_depth", 2.0),
        ("num_steps", 0),
        ("num_steps", 2.5),
        ("num_steps", True),
        ("direction", "sideways"),
        ("side_walls", "top"),
        ("riser_offsets", (0.01,)),
        ("flight_width", 0.1),
    ],
)
def test_wrong_values_are_named(field, value):
    with pytest.raises(SpecError, match=field):
        StairSpec(**{field: value})


def test_json_with_unknown_field_names_the_choices():
    with pytest.raises(SpecError, match="riser_height"):
        StairSpec.from_json('{"riser": 0.1}')
    with pytest.raises(SpecError, match="JSON"):
        StairSpec.from_json("not json")


def test_specs_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        StairSpec().riser_height = 0.1
