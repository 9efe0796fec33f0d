from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from stair_env.common.transforms import look_at
from stair_env.intrinsics import Intrinsics
from stair_env.scene.appearance import AppearanceSpec, SurfaceLook
from stair_env.scene.marks import LightPattern, Soiling
from stair_env.scene.shapes import Shape, box_between
from stair_env.sensors.camera.renderers import make_renderer
from stair_env.sensors.camera.renderers.shading import MIP_TEXELS
from stair_env.sensors.camera.renderers.shading_tables import linear_from_srgb, mip_levels

INTRINSICS = Intrinsics(96, 96, 90.0, 90.0, 48.0, 48.0)
FLOOR = box_between((-8.0, -8.0, -0.5), (8.0, 8.0, 0.0), "floor")
DOWN = look_at((-1e-3, 0.0, 2.0), (0.0, 0.0, 0.0))  # image up is +x, image right is -y
CONCRETE = SurfaceLook("concrete", seed=1)


def look(**fields):
    chosen = {"floor": CONCRETE, "tread": CONCRETE, "riser": CONCRETE, "wall": CONCRETE, "specular_strength": 0.0}
    return AppearanceSpec(**{**chosen, **fields})


def draw(*shapes, appearance, pose=DOWN, **options):
    scene = SimpleNamespace(shapes=shapes, edges=())
    options = {"antialias": False, **options}
    return make_renderer("raycast", scene, appearance=appearance, **options).render(INTRINSICS, pose)


def linear(frame):
    return linear_from_srgb(frame.rgb / 255.0)


def test_srgb_of_the_kernel_inverts_the_decoding():
    gains = np.linspace(0.02, 0.6, 15)
    means = []
    for gain in gains:
        surface = SurfaceLook("concrete", seed=1, brightness=float(gain))
        frame = draw(FLOOR, appearance=look(floor=surface, light_intensity=0.0, ambient_level=1.0), textures=False)
        means.append(linear(frame).mean())
    ratio = np.array(means) / gains
    assert np.ptp(ratio) < 0.05 * ratio.mean()  # proportional to the light, up to rounding to 8 bits


def test_a_textured_surface_has_its_texture_mean():
    appearance = look(light_intensity=0.0, ambient_level=0.6)
    textured, plain = (draw(FLOOR, appearance=appearance, textures=flag) for flag in (True, False))
    assert np.allclose(linear(textured).mean(axis=(0, 1)), linear(plain).mean(axis=(0, 1)), rtol=0.1)
    assert (linear(textured).std(axis=(0, 1)) > 0.01).all()
    assert (linear(plain).std(axis=(0, 1)) < 1e-3).all()


def test_mip_levels_keep_the_mean_and_their_number():
    texels = mip_levels("concrete", 1)
    assert texels.shape == (MIP_TEXELS,)
    red = (texels & 255) / 255.0
    assert np.mean(red[: 256 * 256] ** 2) == pytest.approx(red[-1] ** 2, rel=0.02)


def test_night_without_light_is_black_and_linear_light_scales():
    dark = look(lighting="night", light_intensity=0.0, ambient_level=0.0, sky_horizon=(0, 0, 0), sky_zenith=(0, 0, 0))
    assert draw(FLOOR, appearance=dark).rgb.max() == 0
    dim = draw(FLOOR, appearance=look(light_intensity=0.0, ambient_level=0.004))
    assert 0 < dim.rgb.max() < 20


def test_a_shadow_falls_where_the_ray_to_the_sun_is_blocked():
    plate = box_between((-0.2, -0.2, 0.5), (0.2, 0.2, 0.52), "wall")
    sun = (0.0, -0.6, 0.8)  # from the right, where image u grows
    appearance = look(light_direction=sun, ambient_level=0.1, light_intensity=0.8)
    lit, shaded = (linear(draw(FLOOR, plate, appearance=appearance, shadows=flag)) for flag in (False, True))
    darker = shaded.sum(-1) < 0.5 * lit.sum(-1)
    shadow = INTRINSICS.deproject(np.argwhere(darker)[:, ::-1] + 0.5, 2.0)  # camera x right = -y, y down = -x
    on_floor = shadow[np.abs(shadow[:, 0] + 0.375) < 0.5]
    # The plate's middle is 0.5 m up, so its shadow lies 0.5 * 0.6 / 0.8 m to the left; the plate hides a part of it.
    assert len(on_floor) > 100
    assert on_floor[:, 0].min() == pytest.approx(-0.375 - 0.2 - 0.01, abs=0.04)
    assert np.abs(on_floor[:, 1]).max() == pytest.approx(0.2, abs=0.04)
    assert (shaded <= lit + 1e-6).all()


@pytest.mark.parametrize(
    ("kind", "size"), [("sphere", (0.2, 0, 0)), ("cylinder", (0.2, 0.1, 0)), ("capsule", (0.1, 0.1, 0))]
)
def test_round_solids_cast_round_shadows(kind, size):
    solid = Shape(kind, (0.0, 0.0, 0.6), size, surface="wall")
    appearance = look(light_direction=(0.0, -0.6, 0.8), ambient_level=0.1, light_intensity=0.8)
    lit, shaded = (linear(draw(FLOOR, solid, appearance=appearance, shadows=flag)) for flag in (False, True))
    darker = (shaded.sum(-1) < 0.5 * lit.sum(-1)) & (draw(FLOOR, solid, appearance=appearance).segmentation == 0)
    v, u = np.nonzero(darker)
    assert len(v) > 30
    assert v.mean() == pytest.approx(48.0, abs=1.5)
    assert u.mean() < 48 - 0.3 / 2 * 90  # to the left


def test_a_lamp_lights_with_the_square_of_the_distance_and_casts_shadows():
    appearance = look(lamp_position=(0.0, 0.0, 1.0), light_intensity=0.5, ambient_level=0.0)
    plain = linear(draw(FLOOR, appearance=appearance, textures=False)).sum(-1)
    # cos / d^2 at 0 and at 1 m sideways of the foot of the lamp: 1 against 2**-1.5
    assert plain[48, 3] / plain[48, 48] == pytest.approx(2**-1.5, rel=0.05)
    post = box_between((-0.1, 0.3, 0.0), (0.1, 0.35, 0.3), "wall")
    shaded = linear(draw(FLOOR, post, appearance=appearance, textures=False)).sum(-1)
    assert shaded[48, 48 - 20] < 0.1 * plain[48, 48 - 20]  # 0.44 m to the left, behind the post
    assert shaded[48, 48 + 20] == pytest.approx(plain[48, 48 + 20], rel=0.02)


def test_light_fades_into_an_inner_edge_but_not_into_a_flush_joint():
    wall = box_between((-4.0, 0.3, 0.0), (4.0, 0.4, 1.0), "wall")
    flush = box_between((-4.0, -4.0, -0.5), (4.0, -0.3, 0.0), "floor")
    appearance = look(light_intensity=0.0, ambient_level=0.6)
    left_only = box_between((-8.0, -0.3, -0.5), (8.0, 8.0, 0.0), "floor")
    shade = linear(draw(left_only, flush, wall, appearance=appearance, textures=False)).sum(-1)[48]
    middle = shade[48]
    foot = 48 - round(0.29 / 2 * 90)
    assert shade[foot] < 0.75 * middle
    assert shade[48 + round(0.3 / 2 * 90)] == pytest.approx(middle, rel=0.01)


def test_tread_and_riser_have_their_own_materials():
    appearance = look(
        tread=SurfaceLook("painted", tint=(1, 0, 0)),
        riser=SurfaceLook("painted", tint=(0, 1, 0)),
        light_intensity=0.0,
        ambient_level=0.6,
    )
    step = box_between((0.0, -1.0, 0.0), (2.0, 1.0, 0.3), "step")
    pose = look_at((-1.0, 0.0, 0.6), (0.2, 0.0, 0.25))
    frame = draw(FLOOR, step, appearance=appearance, pose=pose)
    points = pose[:3, 3] + (INTRINSICS.rays() * frame.depth_m[..., None]) @ pose[:3, :3].T
    on_step = frame.segmentation == 1
    top, front = on_step & (points[..., 2] > 0.299) & (points[..., 0] > 0.01), on_step & (points[..., 2] < 0.29)
    assert top.any()
    assert front.any()
    assert frame.rgb[top][:, 0].min() > 100
    assert frame.rgb[top][:, 1].max() < 5
    assert frame.rgb[front][:, 1].min() > 50
    assert frame.rgb[front][:, 0].max() < 5


def test_gloss_brightens_the_mirror_direction():
    polished = SurfaceLook("terrazzo", seed=0)
    sun = (0.6, 0.0, 0.8)
    pose = look_at((-1.2, 0.0, 1.6), (0.0, 0.0, 0.0))  # the mirror image of the sun is in the middle
    dull, bright = (
        linear(draw(FLOOR, appearance=look(floor=polished, light_direction=sun, specular_strength=s), pose=pose))
        for s in (0.0, 2.0)
    )
    gain = (bright - dull).sum(-1)
    assert gain[44:52, 44:52].mean() > 5 * abs(gain[44:52, :8].mean())
    assert gain[44:52, 44:52].mean() > 0.05


def test_smoothing_blends_borders_and_leaves_the_rest():
    plank = box_between((-0.5, -0.11, 0.0), (0.5, 0.1, 0.02), "wall")
    appearance = look(wall=SurfaceLook("painted", tint=(1, 0, 0)), floor=SurfaceLook("painted", tint=(0, 0, 1)))
    pose = look_at((-1e-3, 0.0, 2.0), (0.0, 0.0, 0.0), roll_rad=0.2)
    rough, smooth = (draw(FLOOR, plank, appearance=appearance, pose=pose, antialias=flag) for flag in (False, True))
    assert np.array_equal(rough.depth_m, smooth.depth_m)
    assert np.array_equal(rough.segmentation, smooth.segmentation)
    inside = rough.segmentation == 1
    border = np.zeros_like(inside)
    for axis in (0, 1):
        for step in (-1, 1):
            border |= np.roll(inside, step, axis) != inside
    share = smooth.rgb[..., 0] / 255.0
    mixed = (share > 0.25 * share.max()) & (share < 0.75 * share.max())
    assert mixed[border].mean() > 0.2  # neither wall nor floor
    away = ~cv2.dilate(border.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    changed = (rough.rgb != smooth.rgb).any(axis=-1)
    assert changed[border].any()
    assert not (changed & away).any()


SUN_ABOVE = {"light_direction": (0.0, 0.0, 1.0), "ambient_level": 0.2, "light_intensity": 0.7}


@pytest.mark.parametrize("where", [SUN_ABOVE, {**SUN_ABOVE, "lamp_position": (0.0, 0.0, 3.0), "light_intensity": 6.0}])
def test_bars_out_of_sight_take_their_share_of_the_light(where):
    plain = linear(draw(FLOOR, appearance=look(**where), textures=False))
    bars = LightPattern(period_m=(0.1, 1.0), shade=(0.4, 0.0), softness=0.02, strength=0.9)
    barred = linear(draw(FLOOR, appearance=look(**where, light_pattern=bars), textures=False))
    assert (barred <= plain + 0.01).all()
    dark = barred.sum(-1) < 0.7 * plain.sum(-1)
    assert 0.3 < dark.mean() < 0.5
    straight = dark.mean(axis=0), dark.mean(axis=1)  # bars run along rows or columns of the image
    assert max(np.ptp(profile) for profile in straight) > 0.9


def test_bars_take_nothing_where_shadows_are_off():
    bars = LightPattern(strength=0.9)
    plain, barred = (draw(FLOOR, appearance=look(light_pattern=p), shadows=False).rgb for p in (None, bars))
    assert np.array_equal(plain, barred)


def test_a_lane_is_lighter_in_its_middle_and_patches_are_darker():
    def shade(**fields):
        return linear(draw(FLOOR, appearance=look(soiling=Soiling(**fields)), textures=False)).sum(-1)

    new = shade()
    ratio = (shade(lane_gain=0.5, lane_half_width=0.5) / new).mean(axis=0)
    assert ratio[48] == pytest.approx(1.5, abs=0.05)
    assert ratio[0] == pytest.approx(1.0, abs=0.02) == ratio[-1]
    patched = shade(patch_strength=0.5, patch_period_m=(0.8, 0.8), patch_share=0.5) / new
    assert patched.min() == pytest.approx(0.5, abs=0.05) and patched.max() == pytest.approx(1.0, abs=0.05)
    assert 0.1 < (patched < 0.75).mean() < 0.9


def test_soft_light_comes_from_where_it_is_tilted_to_and_dirt_lies_in_corners():
    wall = box_between((0.3, -3.0, 0.0), (0.5, 3.0, 2.0), "wall")
    pose = look_at((-1.0, 0.0, 1.0), (0.3, 0.0, 0.2))

    def shade(**fields):
        return linear(draw(FLOOR, wall, appearance=look(light_intensity=0.0, **fields), pose=pose, textures=False)).sum(
            -1
        )

    level, from_behind = shade(ambient_tilt=(0.0, 0.0, 0.0)), shade(ambient_tilt=(-0.3, 0.0, 0.0))
    assert from_behind[5].mean() > 1.2 * level[5].mean()  # the wall, which faces the camera
    assert from_behind[-5].mean() == pytest.approx(level[-5].mean(), rel=0.02)  # the floor
    dirt = shade(soiling=Soiling(grime=0.9)) / shade()
    assert dirt.min() < 0.4 and dirt[-5].mean() > 0.97
    assert (shade(corner_shade=0.9) / shade(corner_shade=0.1)).min() < 0.3
