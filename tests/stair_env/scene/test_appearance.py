import dataclasses
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stair_env.common.validation import SpecError
from stair_env.scene.appearance import SURFACES, AppearanceSpec, NosingStrip, SurfaceLook
from stair_env.scene.marks import LightPattern, Soiling
from stair_env.scene.materials.textures import MATERIALS

unit = st.floats(0.0, 1.0)
colours = st.tuples(unit, unit, unit)
looks = st.builds(
    SurfaceLook,
    material=st.sampled_from(MATERIALS),
    seed=st.integers(0, 2**31 - 1),
    tint=colours,
    brightness=st.floats(0.0, 2.0),
    texture_scale=st.floats(0.25, 4.0),
    wear=st.integers(0, 3),
)
pairs = st.tuples(unit, unit)
patterns = st.builds(LightPattern, period_m=st.tuples(*[st.floats(0.02, 5.0)] * 2), shade=pairs, phase=pairs, warp=unit)
soilings = st.builds(
    Soiling,
    lane_gain=st.floats(-0.8, 1.0),
    patch_strength=st.floats(-1.0, 0.95),
    patch_phase=pairs,
    grime=st.floats(-0.5, 0.9),
)
strips = st.builds(
    NosingStrip,
    width_m=st.floats(0.005, 0.12),
    colour=colours,
    material=st.sampled_from(["painted", "rubber", "metal"]),
    lines=st.integers(1, 2),
    missing=unit,
)
directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: math.hypot(*v) > 1e-3)
specs = st.builds(
    AppearanceSpec,
    lighting=st.sampled_from(["day", "night"]),
    tread=looks,
    riser=looks,
    wall=looks,
    distractors=st.lists(looks, min_size=1, max_size=3).map(tuple),
    nosing_strip=st.none() | strips,
    light_pattern=st.none() | patterns,
    soiling=st.none() | soilings,
    ambient_tilt=st.tuples(*[st.floats(-0.4, 0.4)] * 3),
    light_direction=directions,
    lamp_position=st.none() | st.tuples(*[st.floats(-10.0, 10.0)] * 3),
    light_intensity=st.floats(0.0, 50.0),
    shadows=st.booleans(),
)


@given(specs)
def test_json_round_trip(spec):
    assert AppearanceSpec.from_json(spec.to_json()) == spec


def test_a_spec_from_before_a_field_existed_still_loads():
    spec = AppearanceSpec(nosing_strip=NosingStrip())
    values = json.loads(spec.to_json())
    for name in ("ambient_tilt", "corner_shade", "light_pattern", "soiling"):
        del values[name]
    for name in ("drop_m", "material", "lines", "ends_only", "inset_m", "wear", "missing", "seed"):
        del values["nosing_strip"][name]
    del values["tread"]["wear"]
    assert AppearanceSpec.from_json(json.dumps(values)) == spec


@pytest.mark.parametrize(
    "build, field",
    [
        (lambda: LightPattern(strength=1.0), "strength"),
        (lambda: LightPattern(period_m=(0.1,)), "period_m"),
        (lambda: Soiling(patch_share=1.5), "patch_share"),
        (lambda: Soiling(patch_phase=(0.0, 2.0)), "patch_phase"),
        (lambda: SurfaceLook(wear=4), "wear"),
        (lambda: NosingStrip(lines=3), "lines"),
        (lambda: NosingStrip(material="jelly"), "material"),
    ],
)
def test_bad_marks_are_named(build, field):
    with pytest.raises(SpecError, match=field):
        build()


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
