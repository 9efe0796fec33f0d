import dataclasses
import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from stair_env.intrinsics import D435I_COLOR_MODES, D435I_COLOUR_OFFSET_M, Intrinsics
from stair_env.sensors.camera.depth_error import DepthErrorConfig, DepthErrorModel, depth_rms_m, shadow_width_px
from stair_env.sensors.camera.depth_model.depth_holes import hole_probability

H, W = 480, 640
INTRINSICS = D435I_COLOR_MODES["640x480"]
IDEAL = DepthErrorConfig.ideal()


def only(**changes) -> DepthErrorModel:
    return DepthErrorModel(dataclasses.replace(IDEAL, **changes))


def textured(seed=0, low=60, high=200, shape=(H, W)):
    return np.random.default_rng(seed).integers(low, high, (*shape, 3), dtype=np.uint8)


def plane(depth_m, shape=(H, W)):
    return np.full(shape, depth_m, np.float32)


def apply(model, depth_m, rgb=None, seed=0, intrinsics=INTRINSICS):
    return model.apply(depth_m, textured() if rgb is None else rgb, intrinsics, np.random.default_rng(seed))


def box_before_wall(near_m, far_m, columns=slice(300, 450)):
    depth_m = plane(far_m)
    depth_m[100:300, columns] = near_m
    return depth_m


def random_scene(seed):
    """Boxes at random depths before a slanted wall, with a part where there is nothing."""
    rng = np.random.default_rng(seed)
    depth_m = np.tile(np.linspace(2.0, 6.0, W, dtype=np.float32), (H, 1))
    for _ in range(12):
        v, u = rng.integers(0, H - 40), rng.integers(0, W - 40)
        depth_m[v : v + rng.integers(5, 200), u : u + rng.integers(5, 200)] = rng.uniform(0.1, 12.0)
    depth_m[:30] = 0.0
    return depth_m


# --- nothing wrong ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_ideal_passes_depth_through_exactly(seed):
    depth_m = random_scene(seed)
    out = apply(DepthErrorModel(IDEAL), depth_m)
    np.testing.assert_array_equal(out, depth_m)
    assert out is not depth_m and out.dtype == np.float32


def test_input_is_not_changed():
    depth_m, rgb = random_scene(1), textured(1)
    before = depth_m.copy(), rgb.copy()
    apply(DepthErrorModel(), depth_m, rgb)
    np.testing.assert_array_equal(depth_m, before[0])
    np.testing.assert_array_equal(rgb, before[1])


# --- noise -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("depth_m", "published_mm"), [(1.0, 3.6), (2.0, 14.0), (3.0, 32.0)])
@pytest.mark.parametrize("mode", ["640x480", "1280x720"])
def test_rms_on_a_plane_follows_the_published_curve(depth_m, published_mm, mode):
    intrinsics = D435I_COLOR_MODES[mode]
    shape = (intrinsics.height, intrinsics.width)
    # Published is the scatter about a fitted plane: neither a unit's slow waves nor whole patches at a false distance.
    model = DepthErrorModel(DepthErrorConfig(structured_px=0.0, false_patches=0.0))
    out = apply(model, plane(depth_m, shape), textured(shape=shape), intrinsics=intrinsics)
    error_mm = 1e3 * (out[out > 0.0] - depth_m)
    assert np.sqrt(np.mean(error_mm**2)) == pytest.approx(published_mm, rel=0.2)
    assert 1e3 * depth_rms_m(depth_m, DepthErrorConfig()) == pytest.approx(published_mm, rel=0.03)


def test_noise_is_alike_within_a_matching_window_and_unlike_beyond():
    out = apply(only(disparity_noise_px=0.08), plane(2.0))
    error = (out - out.mean()).astype(np.float64)

    def correlation(lag):
        return np.mean(error[:, lag:] * error[:, :-lag]) / np.mean(error**2)

    assert correlation(1) > 0.8
    assert abs(correlation(60)) < 0.1


def test_frames_of_one_generator_carry_independent_noise():
    model, rng = only(disparity_noise_px=0.08), np.random.default_rng(3)
    frames = [model.apply(plane(2.0), textured(), INTRINSICS, rng) - 2.0 for _ in range(2)]
    assert abs(np.corrcoef(frames[0].ravel(), frames[1].ravel())[0, 1]) < 0.1


def test_disparity_is_quantised():
    model = only(disparity_quantum_px=1.0 / 32.0)
    depth_m = np.tile(np.linspace(0.5, 6.0, W, dtype=np.float32), (H, 1))
    steps = model.config.focal_px * model.config.baseline_m / apply(model, depth_m)[0] * 32.0
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-3)
    assert len(np.unique(np.rint(steps))) > 100
    disparity = model.config.focal_px * model.config.baseline_m / depth_m[0]
    assert np.abs(steps / 32.0 - disparity).max() <= 0.5 / 32.0 + 1e-4


def test_depth_comes_in_whole_units():
    out = apply(DepthErrorModel(), random_scene(0))
    np.testing.assert_allclose(out * 1000.0, np.rint(out * 1000.0), atol=2e-3)


# --- scale bias ------------------------------------------------------------------------------------------------------


def test_configured_scale_bias_scales_depth():
    np.testing.assert_allclose(apply(only(scale_bias=0.02), plane(2.0)), 2.04, rtol=1e-6)


def test_reset_draws_a_unit_within_the_range_that_frames_do_not_change():
    model, rng = only(scale_bias_range=0.02), np.random.default_rng(0)
    drawn = []
    for _ in range(200):
        model.reset(rng)
        drawn.append(model.scale_bias)
    assert max(np.abs(drawn)) <= 0.02 and np.std(drawn) == pytest.approx(0.02 / np.sqrt(3.0), rel=0.15)
    for _ in range(3):
        np.testing.assert_allclose(apply(model, plane(1.0)), 1.0 + drawn[-1], rtol=1e-6)


# --- shadows ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("near_m", "far_m"), [(0.6, 1.5), (1.0, 1.3), (1.0, 3.0), (2.0, 4.0)])
def test_right_imager_loses_a_strip_left_of_a_near_edge(near_m, far_m):
    depth_m = box_before_wall(near_m, far_m)
    lost = apply(only(occlusion_shadow=True), depth_m) == 0.0
    expected = shadow_width_px(near_m, far_m, INTRINSICS.fx, IDEAL.baseline_m)
    widths = lost[100:300, :300].sum(axis=1)
    assert np.abs(widths - expected).max() <= 1.5
    assert lost[100:300, 299].all(), "the strip begins at the edge"
    assert not lost[:, 300:].any(), "neither the box nor its right side is hidden"
    assert not lost[:100].any() and not lost[300:].any(), "nor what is above or below"


def test_shadow_width_in_pixels_of_the_depth_imager():
    intrinsics = Intrinsics(W, H, IDEAL.focal_px, IDEAL.focal_px, W / 2, H / 2)
    lost = apply(only(occlusion_shadow=True), box_before_wall(1.0, 2.0), intrinsics=intrinsics) == 0.0
    assert lost[200].sum() == pytest.approx(447.0 * 0.05 * 0.5, abs=1.5)


def test_colour_parallax_loses_a_narrower_strip_and_both_add_up():
    depth_m = box_before_wall(0.6, 2.0)
    parallax = (apply(only(colour_parallax=True), depth_m) == 0.0)[200].sum()
    both = (apply(only(colour_parallax=True, occlusion_shadow=True), depth_m) == 0.0)[200].sum()
    assert parallax == pytest.approx(shadow_width_px(0.6, 2.0, INTRINSICS.fx, D435I_COLOUR_OFFSET_M), abs=1.5)
    assert both == pytest.approx(shadow_width_px(0.6, 2.0, INTRINSICS.fx, D435I_COLOUR_OFFSET_M + 0.05), abs=1.5)


def test_camera_looks_past_a_thin_post():
    near_m, far_m, post_px = 1.0, 3.0, 6
    depth_m = box_before_wall(near_m, far_m, slice(300, 300 + post_px))
    hidden = np.flatnonzero(apply(only(occlusion_shadow=True), depth_m)[200] == 0.0)
    assert len(hidden) == pytest.approx(post_px, abs=1.5)
    last = 300 - shadow_width_px(near_m, far_m, INTRINSICS.fx, IDEAL.baseline_m)
    assert hidden.min() == pytest.approx(last, abs=1.5), "the shadow has moved away from the post"


def test_a_slanted_plane_casts_no_shadow():
    u, v = np.meshgrid(np.arange(W), np.arange(H))
    disparity = 10.0 + 0.02 * (u - 320) + 0.01 * (v - 240)
    depth_m = (IDEAL.focal_px * IDEAL.baseline_m / disparity).astype(np.float32)
    model = only(occlusion_shadow=True, colour_parallax=True, flying_share=1.0, edge_jitter_px=3.0)
    np.testing.assert_array_equal(apply(model, depth_m), depth_m)


# --- edges -----------------------------------------------------------------------------------------------------------


def test_flying_pixels_lie_between_near_and_far_and_only_at_edges():
    near_m, far_m = 1.0, 2.0
    depth_m = box_before_wall(near_m, far_m)
    out = apply(only(flying_share=0.5), depth_m)
    flying = out != depth_m
    assert out.min() >= near_m and out.max() <= far_m
    assert np.mean((out[flying] > near_m + 0.05) & (out[flying] < far_m - 0.05)) > 0.7
    rows, columns = np.nonzero(flying)
    to_edge = np.minimum(
        np.minimum(np.abs(rows - 99.5), np.abs(rows - 299.5)),
        np.minimum(np.abs(columns - 299.5), np.abs(columns - 449.5)),
    )
    assert 500 < flying.sum() < 8000 and to_edge.max() <= 4.0


def test_edge_jitter_moves_edges_both_ways_without_inventing_depths():
    depth_m = box_before_wall(1.0, 2.0)
    out = apply(only(edge_jitter_px=1.0), depth_m)
    assert set(np.unique(out)) == {np.float32(1.0), np.float32(2.0)}
    assert (out < depth_m).any() and (out > depth_m).any()
    interior = np.s_[110:290, 310:440]
    np.testing.assert_array_equal(out[interior], depth_m[interior])


# --- range and holes -------------------------------------------------------------------------------------------------


def test_readings_outside_the_range_are_dropped():
    depth_m = np.tile(np.linspace(0.05, 12.0, W, dtype=np.float32), (H, 1))
    out = apply(only(min_range_m=0.18, max_range_m=10.0), depth_m)
    np.testing.assert_array_equal(out > 0.0, (depth_m >= 0.18) & (depth_m <= 10.0))


def test_textureless_holes_grow_with_distance_and_need_the_projector():
    grey = np.full((H, W, 3), 120, np.uint8)

    def lost(depth_m, **changes):
        return np.mean(apply(only(textureless_dropout=0.9, **changes), plane(depth_m), grey) == 0.0)

    assert lost(2.0, projector_range_m=3.5) == 0.0
    assert 0.0 < lost(4.0, projector_range_m=3.5) < lost(6.0, projector_range_m=3.5) < 0.9
    assert lost(2.0, projector_range_m=0.0) == pytest.approx(0.9, abs=0.03)
    assert np.mean(apply(only(textureless_dropout=0.9), plane(6.0), textured()) == 0.0) < 0.01


def test_only_horizontal_contrast_helps_matching():
    stripes = np.tile(np.where(np.arange(W) % 4 < 2, 60, 180).astype(np.uint8), (H, 1))
    model = only(textureless_dropout=0.9, projector_range_m=0.0)
    upright = np.repeat(stripes[..., None], 3, axis=2)
    lying = np.repeat(np.resize(stripes[0], (H, 1)).repeat(W, axis=1)[..., None], 3, axis=2)
    assert np.mean(apply(model, plane(2.0), upright) == 0.0) < 0.01
    assert np.mean(apply(model, plane(2.0), lying) == 0.0) > 0.5


def test_near_surfaces_survive_a_night_without_light():
    black = np.zeros((H, W, 3), np.uint8)
    assert np.mean(apply(DepthErrorModel(), plane(1.5), black) > 0.0) > 0.98


def test_dark_and_shining_surfaces_have_holes():
    rgb = np.full((H, W, 3), 128, np.uint8)
    rgb[:, :200], rgb[:, 400:] = 4, 255
    model = only(dark_dropout=0.5, specular_dropout=0.6, projector_range_m=3.5)
    lost, near = apply(model, plane(4.0), rgb) == 0.0, apply(model, plane(1.0), rgb) == 0.0
    assert 0.02 < near[:, :190].mean() < 0.6 * lost[:, :190].mean()
    assert lost[:, :190].mean() > 0.3 and lost[:, 410:].mean() > 0.4 and lost[:, 210:390].mean() < 0.02


def test_speckle_covers_the_given_share_in_blobs():
    lost = apply(only(speckle=0.05), plane(1.0)) == 0.0
    assert lost.mean() == pytest.approx(0.05, abs=0.01)
    neighbour_too = (lost[:, 1:] & lost[:, :-1]).sum() / lost.sum()
    assert neighbour_too > 0.5


def test_hole_probability_stays_a_probability():
    rng = np.random.default_rng(0)
    shape = (40, 50)
    config = DepthErrorConfig(speckle=0.5, textureless_dropout=1.0, dark_dropout=1.0, specular_dropout=1.0)
    values = hole_probability(
        config,
        rng.uniform(0, 255, shape),
        rng.uniform(0, 60, shape),
        rng.uniform(0, 1, shape),
        rng.uniform(0, 6, shape),
    )
    assert values.min() >= 0.0 and values.max() < 1.0


# --- robustness ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_output_is_finite_and_not_negative_whatever_comes_in(seed):
    depth_m, rng = random_scene(seed), np.random.default_rng(seed)
    for value in (np.nan, np.inf, -np.inf, -1.0, 1e-30, 1e30, 0.0):
        depth_m[rng.integers(0, H, 2000), rng.integers(0, W, 2000)] = value
    config = DepthErrorConfig(disparity_noise_px=1.0, min_range_m=0.0, max_range_m=1e6, flying_share=0.5)
    for model in (DepthErrorModel(), DepthErrorModel(config), DepthErrorModel(IDEAL)):
        out = apply(model, depth_m, textured(seed, 0, 256))
        assert np.isfinite(out).all() and (out >= 0.0).all()
        unseen = ~(np.isfinite(depth_m) & (depth_m > 0.0) & (depth_m < 1e6))
        if model.config == IDEAL:
            assert not out[unseen].any()


@pytest.mark.parametrize("shape", [(1, 1), (3, 700), (90, 5), (65, 33)])
def test_any_image_size_works(shape):
    intrinsics = Intrinsics(shape[1], shape[0], 400.0, 400.0, shape[1] / 2, shape[0] / 2)
    out = apply(DepthErrorModel(), plane(1.0, shape), textured(shape=shape), intrinsics=intrinsics)
    assert out.shape == shape and out[out > 0.0] == pytest.approx(1.0, abs=0.03)


def test_same_generator_state_same_frame_whatever_came_before_and_on_any_thread():
    model, scenes = DepthErrorModel(), [random_scene(seed) for seed in range(4)]
    expected = [apply(DepthErrorModel(), scene, seed=7) for scene in scenes]
    for scene, wanted in zip(scenes[::-1], expected[::-1]):
        np.testing.assert_array_equal(apply(model, scene, seed=7), wanted)
    with ThreadPoolExecutor(4) as pool:
        for found, wanted in zip(pool.map(lambda scene: apply(model, scene, seed=7), scenes * 3), expected * 3):
            np.testing.assert_array_equal(found, wanted)
    assert not np.array_equal(apply(model, scenes[0], seed=8), expected[0])


def test_a_frame_takes_the_same_random_numbers_whatever_is_configured():
    states = []
    for model in (DepthErrorModel(), DepthErrorModel(IDEAL)):
        rng = np.random.default_rng(0)
        model.apply(plane(1.0), textured(), INTRINSICS, rng)
        states.append(rng.bit_generator.state)
    assert states[0] == states[1]


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("depth_m", {"depth_m": plane(1.0).astype(np.float64)}),
        ("depth_m", {"depth_m": plane(1.0)[None]}),
        ("depth_m", {"depth_m": [[1.0]]}),
        ("rgb", {"rgb": textured().astype(np.float32)}),
        ("rgb", {"rgb": textured()[:, :-1]}),
        ("rgb", {"rgb": textured()[..., 0]}),
        ("rgb", {"rgb": None}),
        ("intrinsics", {"intrinsics": D435I_COLOR_MODES["848x480"]}),
        ("rng", {"rng": 0}),
    ],
)
def test_bad_input_is_named(name, changes):
    given = {"depth_m": plane(1.0), "rgb": textured(), "intrinsics": INTRINSICS, "rng": np.random.default_rng(0)}
    with pytest.raises(ValueError, match=f"^{name}"):
        DepthErrorModel().apply(**{**given, **changes})


def test_config_round_trips_through_json():
    config = DepthErrorConfig(scale_bias=0.01, occlusion_shadow=False)
    assert DepthErrorConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert DepthErrorConfig.from_dict({}) == DepthErrorConfig()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("disparity_noise_px", -0.1),
        ("disparity_noise_px", float("nan")),
        ("baseline_m", 0.0),
        ("scale_bias_range", 0.5),
        ("speckle", "much"),
        ("occlusion_shadow", 1),
        ("min_range_m", 3.0),
        ("max_range_m", 0.1),
        ("nois", 1.0),
    ],
)
def test_wrong_config_is_named(field, value):
    with pytest.raises(ValueError, match=field):
        DepthErrorConfig.from_dict({field: value})
    with pytest.raises(ValueError, match="dict"):
        DepthErrorConfig.from_dict([field])


# --- what matching does to stairs ------------------------------------------------------------------------------------


def crease(row=240, per_row=0.06):
    """A concave crease along a row: disparity rises away from it on both sides."""
    disparity = 12.0 + per_row * np.abs(np.arange(H) - row)
    return np.repeat((IDEAL.focal_px * IDEAL.baseline_m / disparity)[:, None], W, axis=1).astype(np.float32)


def test_creases_are_rounded_over_the_window_and_nothing_else_changes():
    depth_m, window = crease(), 13.0
    out = apply(only(crease_window_px=(window, window)), depth_m)
    error_px = np.abs(IDEAL.focal_px * IDEAL.baseline_m * (1.0 / out - 1.0 / depth_m))[:, 300]
    half = window / 2 * INTRINSICS.fx / IDEAL.focal_px
    assert error_px[240] == pytest.approx(0.06 * half / 2.0, rel=0.15), "the mean of a triangle over the window"
    assert error_px.argmax() == 240
    far = np.abs(np.arange(H) - 240) > half + 1
    np.testing.assert_array_equal(out[far], depth_m[far])


def test_each_unit_has_its_own_window_place_and_surroundings():
    model, rng = DepthErrorModel(), np.random.default_rng(0)
    units = []
    for _ in range(200):
        model.reset(rng)
        units.append(model.unit)
    low, high = model.config.crease_window_px
    windows = [unit.crease_window_px for unit in units]
    assert low <= min(windows) < low + 1 and high - 1 < max(windows) <= high
    assert np.ptp([unit.severity for unit in units]) > 1.8
    assert max(abs(shift) for unit in units for shift in unit.shift_px) <= model.config.misalignment_px


def test_reset_takes_the_same_random_numbers_whatever_is_configured():
    states = []
    for model in (DepthErrorModel(), DepthErrorModel(IDEAL)):
        rng = np.random.default_rng(0)
        model.reset(rng)
        states.append(rng.bit_generator.state)
    assert states[0] == states[1]


def test_structured_error_stays_with_the_unit_and_is_broad():
    model = only(structured_px=0.1)
    model.reset(np.random.default_rng(1))
    frames = [apply(model, plane(1.0), seed=seed) for seed in range(2)]
    np.testing.assert_array_equal(*frames)
    error_px = IDEAL.focal_px * IDEAL.baseline_m * (1.0 / frames[0].astype(np.float64) - 1.0)
    assert error_px.std() == pytest.approx(0.1, rel=0.4)
    assert np.abs(np.diff(error_px, axis=1)).max() < 0.02
    model.reset(np.random.default_rng(2))
    assert not np.array_equal(apply(model, plane(1.0)), frames[0])


def test_single_holes_are_single():
    lost = apply(only(single_holes=0.01), plane(1.0)) == 0.0
    assert lost.mean() == pytest.approx(0.01, rel=0.15)
    assert (lost[:, 1:] & lost[:, :-1]).sum() < 0.05 * lost.sum()


def test_fattening_lets_the_near_side_grow():
    depth_m = box_before_wall(1.0, 2.0)
    out = apply(only(fattened_share=0.5), depth_m)
    assert set(np.unique(out)) == {np.float32(1.0), np.float32(2.0)}
    assert (out < depth_m).sum() > 500 and not (out > depth_m).any()


def test_bands_are_lost_along_creases_where_nothing_has_texture():
    grey, model = np.full((H, W, 3), 120, np.uint8), only(lost_treads=0.9)
    lost = apply(model, crease(per_row=0.08), grey) == 0.0
    assert lost[232:248].mean() > 0.3 and not lost[:200].any() and not lost[280:].any()
    along, across = (np.mean(lost[232:248, 3:] & lost[232:248, :-3]), np.mean(lost[235:248] & lost[232:245]))
    assert along > 0.9 * lost[232:248].mean() and across < along, "bands are long"
    assert np.mean(apply(model, crease(per_row=0.08))[232:248] == 0.0) < 0.6 * lost[232:248].mean()
    assert not (apply(model, plane(1.5), grey) == 0.0).any()


def test_false_patches_are_too_near_and_rare():
    out = apply(only(false_patches=0.02), plane(2.0))
    false = np.abs(out - 2.0) > 0.01
    assert false.mean() == pytest.approx(0.02, rel=0.3)
    assert (out[false] < 1.6).all() and (out[false] > 0.8).all()
    assert (false[:, 1:] & false[:, :-1]).sum() > 0.8 * false.sum()


def test_a_misaligned_unit_shifts_and_scales_the_image_by_a_pixel_or_two():
    depth_m, model = box_before_wall(1.0, 2.0), only(misalignment_px=1.5, focal_error_range=0.003)
    places = []
    for seed in range(30):
        model.reset(np.random.default_rng(seed))
        near = apply(model, depth_m) == 1.0
        places.append((np.flatnonzero(near[200])[0], np.flatnonzero(near[:, 400])[0]))
    places = np.array(places) - (300, 100)
    assert (np.ptp(places, axis=0) >= 2).all() and np.abs(places).max() <= 3
    model.reset(np.random.default_rng(0))
    np.testing.assert_array_equal(apply(model, depth_m), apply(model, depth_m, seed=5))


def test_a_standing_camera_keeps_part_of_its_noise_and_its_holes():
    model, rng = DepthErrorModel(), np.random.default_rng(0)

    def frames(standing):
        out = [model.apply(plane(2.0), textured(), INTRINSICS, rng, standing) for _ in range(2)]
        both = (out[0] > 0.0) & (out[1] > 0.0) & (np.abs(out[0] - 2) < 0.1) & (np.abs(out[1] - 2) < 0.1)
        structured = model.config.structured_px**2
        share = np.corrcoef(out[0][both], out[1][both])[0, 1]
        total = structured + model.config.disparity_noise_px**2
        return share * total - structured, np.mean((out[0] == 0.0) & (out[1] == 0.0)) / np.mean(out[0] == 0.0)

    (moving, moving_holes), (standing, standing_holes) = frames(False), frames(True)
    noise = model.config.disparity_noise_px**2
    assert standing - moving == pytest.approx(model.config.still_share * noise, rel=0.5)
    assert moving_holes < 0.2 < 0.4 < standing_holes


def test_the_filters_calm_the_noise_and_close_single_holes():
    plain, filtered = (DepthErrorModel(DepthErrorConfig(filters=on, structured_px=0.0)) for on in (False, True))
    raw, calm = (apply(model, plane(2.0)) for model in (plain, filtered))

    def spread(out):
        return np.percentile(np.abs(out[out > 0.0] - 2.0), 68)

    assert spread(calm) < 0.75 * spread(raw)
    assert np.mean(calm == 0.0) < 0.6 * np.mean(raw == 0.0)
    assert filtered.unit.crease_window_px > 1.2 * plain.unit.crease_window_px
