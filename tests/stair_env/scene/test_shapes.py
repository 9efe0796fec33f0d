import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stair_env.scene.shapes import build_stair_shapes
from stair_env.stairs import StairSpec


def top_under(shapes, x):
    """Height of the highest box top over a point of the middle line."""
    tops = [
        shape.position[2] + shape.size[2]
        for shape in shapes
        if shape.surface in ("step", "floor")
        and abs(x - shape.position[0]) <= shape.size[0]
        and abs(shape.position[1]) <= shape.size[1]
    ]
    return max(tops)


@settings(max_examples=60)
@given(
    direction=st.sampled_from(["up", "down", "up_down"]),
    overhang=st.sampled_from([0.0, 0.02]),
    open_risers=st.booleans(),
    steps=st.integers(1, 6),
    where=st.floats(0.02, 0.98),
)
def test_walking_on_the_boxes_is_walking_on_the_profile(direction, overhang, open_risers, steps, where):
    spec = StairSpec(direction=direction, num_steps=steps, nosing_overhang=overhang, open_risers=open_risers)
    shapes, profile = build_stair_shapes(spec), spec.profile()
    bounds = np.concatenate([[-1.0], profile.edge_x, [profile.edge_x[-1] + 1.0]])
    for left, right, level in zip(bounds[:-1], bounds[1:], profile.level_z):
        assert top_under(shapes, left + where * (right - left)) == pytest.approx(level)


def test_riser_is_recessed_under_an_overhang():
    spec = StairSpec(num_steps=2, nosing_overhang=0.03)
    bodies = [shape for shape in build_stair_shapes(spec) if shape.surface == "step" and shape.size[2] > 0.03]
    assert bodies[0].position[0] - bodies[0].size[0] == pytest.approx(0.03)


def test_walls_and_rails_stand_beside_the_flight():
    spec = StairSpec(side_walls="left", handrails=True, stringers=True)
    shapes = build_stair_shapes(spec)
    walls = [shape for shape in shapes if shape.surface == "wall"]
    rails = [shape for shape in shapes if shape.surface == "rail"]
    assert len(walls) == 1 and walls[0].position[1] > spec.flight_width / 2
    assert rails and all(rail.position[1] < 0 for rail in rails)  # the other side has the wall
    assert sum(shape.surface == "stringer" for shape in shapes) == 2


def test_shapes_are_plain_finite_numbers():
    for shape in build_stair_shapes(StairSpec(direction="up_down", handrails=True, stringers=True)):
        numbers = [*shape.position, *shape.size, *shape.orientation]
        assert all(type(number) is float for number in numbers)
        assert np.isfinite(numbers).all()
