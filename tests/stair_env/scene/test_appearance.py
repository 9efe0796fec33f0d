import dataclasses
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stair_env.common.validation import SpecError
from stair_env.scene.appearance import SURFACES, AppearanceSpec, NosingStrip, SurfaceLook
from stair_env.scene.textures import MATERIALS

unit = st.floats(0.0, 1.0)
colours = st.tuples(unit, unit, unit)
looks = st.builds(
    SurfaceLook,
    material=st.sampled_from(MATERIALS),
    seed=st.integers(0, 2**31 - 1),
    tint=colours,
    brightness=st.floats(0.0, 2.0),
    texture_scale=st.floats(0.25, 4.0),
)
directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: math.hypot(*v) > 1e-3)
specs = st.builds(
    AppearanceSpec,
    lighting=st.sampled_from(["day", "night"]),
    tread=looks,
    riser=looks,
    wall=looks,
    distractors=st.lists(looks, min_size=1, max_size=3).map(tuple),
    nosing_strip=st.none() | st.builds(NosingStrip, width_m=st.floats(0.005, 0.12), colour=colours),
    light_direction=directions,
    lamp_position=st.none() | st.tuples(*[st.floats(-10.0, 10.0)] * 3),
    light_intensity=st.floats(0.0, 50.0),
    shadows=st.booleans(),
)


@given(specs)
def test_json_round_trip(spec):
    assert AppearanceSpec.from_json(spec.to_json()) == spec


@given(specs)
def test_light_direction_is_a_unit_vector(spec):
    assert math.hypot(*spec.light_direction) == pytest.approx(1.0)


@given(specs)
def test_every_surface_has_a_look(spec):
    for surface in (*SURFACES, "distractor:fence", "distractor:fence:2"):
        for faces_up in (True, False):
            assert isinstance(spec.look(surface, faces_up), SurfaceLook)


def test_tread_and_riser_are_told_apart_by_the_normal():
    spec = AppearanceSpec(tread=SurfaceLook("wood"), riser=SurfaceLook("tile"))
    assert spec.look("step", faces_up=True).material == "wood"
    assert spec.look("step", faces_up=False).material == "tile"


def test_distractors_walk_through_the_palette():
    palette = (SurfaceLook("wood"), SurfaceLook("metal"))
    spec = AppearanceSpec(distractors=palette)
    assert [spec.look(f"distractor:box:{k}") for k in range(3)] == [palette[0], palette[1], palette[0]]


def test_gain_is_tint_times_brightness():
    assert SurfaceLook(tint=(1.0, 0.5, 0.25), brightness=0.5).gain == (0.5, 0.25, 0.125)


@pytest.mark.parametrize(
    "field, value",
    [
        ("lighting", "dusk"),
        ("light_direction", (0.0, 0.0, 0.0)),
        ("light_direction", (0.0, math.nan, 1.0)),
        ("light_colour", (1.0, 2.0, 0.0)),
        ("light_colour", (1.0, 1.0)),
        ("light_intensity", -1.0),
        ("ambient_level", math.inf),
        ("exposure", math.nan),
        ("distractors", ()),
        ("lamp_position", (0.0, 0.0)),
    ],
)
def test_bad_values_are_named(field, value):
    with pytest.raises(SpecError, match=field):
        AppearanceSpec(**{field: value})


def test_unknown_surface_and_material_name_the_choices():
    with pytest.raises(SpecError, match="'floor'"):
        AppearanceSpec().look("sea")
    with pytest.raises(SpecError, match="'brick'"):
        SurfaceLook("jelly")


@pytest.mark.parametrize("text", ["", "[]", "{", '{"light": 1}', '{"tread": {"stuff": 1}}', '{"tread": 3}'])
def test_bad_json_is_refused(text):
    with pytest.raises(SpecError):
        AppearanceSpec.from_json(text)


def test_specs_are_frozen_and_hashable():
    spec = AppearanceSpec()
    assert hash(spec) == hash(AppearanceSpec.from_json(spec.to_json()))
    with pytest.raises(dataclasses.FrozenInstanceError):
        spec.exposure = 2.0
    assert json.loads(spec.to_json())["lighting"] == "day"
