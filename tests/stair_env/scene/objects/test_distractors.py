import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stair_env.common.validation import SpecError
from stair_env.scene.appearance import AppearanceSpec
from stair_env.scene.objects.distractors import DISTRACTOR_KINDS, FLAT_KINDS, DistractorSpec

lengths = st.floats(0.2, 3.0)
specs = st.builds(
    DistractorSpec,
    kind=st.sampled_from(DISTRACTOR_KINDS),
    position=st.tuples(*[st.floats(-5.0, 5.0)] * 3),
    yaw_rad=st.floats(-math.pi, math.pi),
    size=st.tuples(lengths, lengths, lengths),
    count=st.integers(1, 20),
    seed=st.integers(0, 2**31 - 1),
    look=st.integers(0, 20),
)


def extents(shape):
    """The entries of its size that must be positive."""
    return shape.size[: {"box": 3, "sphere": 1}.get(shape.kind, 2)]


def corners(shape):
    """(8, 3) corners of a shape's bounding box in the world."""
    radius, length, _ = shape.size
    round_half = {"sphere": radius, "capsule": length + radius}.get(shape.kind, length)
    half = shape.size if shape.kind == "box" else (radius, radius, round_half)
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return Rotation.from_quat(shape.orientation).apply(signs * half) + shape.position


@settings(max_examples=200, deadline=None)
@given(specs)
def test_shapes_are_finite_solid_and_have_a_look(spec):
    assert spec.shapes
    for shape in spec.shapes:
        assert np.isfinite([*shape.position, *shape.size, *shape.orientation]).all()
        assert min(extents(shape)) > 0.0
        assert np.linalg.norm(shape.orientation) == pytest.approx(1.0)
        assert shape.surface.startswith(f"distractor:{spec.kind}")
        AppearanceSpec().look(shape.surface)


@settings(max_examples=200, deadline=None)
@given(specs)
def test_nothing_reaches_below_its_floor(spec):
    lowest = min(corners(shape)[:, 2].min() for shape in spec.shapes)
    # Slats at a slant and the ramp's slab may dip a little: they stand on or in the floor.
    assert lowest > spec.position[2] - 0.12


@settings(max_examples=100, deadline=None)
@given(specs)
def test_same_spec_same_shapes(spec):
    assert spec.shapes == DistractorSpec(**{f: getattr(spec, f) for f in spec.__dataclass_fields__}).shapes


@settings(max_examples=100, deadline=None)
@given(specs, st.floats(-math.pi, math.pi))
def test_turning_keeps_the_parts_in_place_relative_to_each_other(spec, angle):
    fields = {f: getattr(spec, f) for f in spec.__dataclass_fields__}
    turned = DistractorSpec(**{**fields, "yaw_rad": angle})
    for before, after in zip(spec.shapes, turned.shapes):
        a = Rotation.from_euler("z", -spec.yaw_rad).apply(corners(before) - spec.position)
        b = Rotation.from_euler("z", -angle).apply(corners(after) - spec.position)
        assert np.allclose(a, b, atol=1e-6)


@pytest.mark.parametrize("kind", DISTRACTOR_KINDS)
def test_only_what_lies_flat_can_be_walked_through(kind):
    shapes = DistractorSpec(kind).shapes
    flat = max(corners(shape)[:, 2].max() for shape in shapes) < 0.02
    assert flat == (kind in FLAT_KINDS)
    assert {shape.collides for shape in shapes} == {kind not in FLAT_KINDS}


def test_stripes_are_as_many_as_asked_and_do_not_touch():
    shapes = DistractorSpec("crosswalk", size=(3.0, 2.0, 0.1), count=5).shapes
    assert len(shapes) == 5
    ends = sorted((s.position[0] - s.size[0], s.position[0] + s.size[0]) for s in shapes)
    assert all(right < left for (_, right), (left, _) in itertools.pairwise(ends))


@pytest.mark.parametrize(
    "field, value",
    [
        ("kind", "cat"),
        ("size", (0.0, 1.0, 1.0)),
        ("size", (1.0, 1.0)),
        ("count", 0),
        ("count", 2.5),
        ("yaw_rad", math.nan),
    ],
)
def test_bad_values_are_named(field, value):
    with pytest.raises(SpecError, match=field):
        DistractorSpec(**{"kind": "fence", field: value})
