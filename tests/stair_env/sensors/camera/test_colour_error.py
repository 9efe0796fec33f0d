import dataclasses
import json

import numpy as np
import pytest

from stair_env.sensors.camera.colour_error import MAX_SMEAR_PX, ColourErrorConfig, ColourErrorModel, blur_weights, trail

H, W = 240, 320
IDEAL = ColourErrorConfig.ideal()


def only(**changes) -> ColourErrorModel:
    model = ColourErrorModel(dataclasses.replace(IDEAL, **changes))
    model.reset(np.random.default_rng(0))
    return model


def grey(level, shape=(H, W)):
    return np.full((*shape, 3), level, np.uint8)


def scene(seed=0):
    return np.random.default_rng(seed).integers(0, 256, (H, W, 3), dtype=np.uint8)


def apply(model, rgb, seed=0, **options):
    return model.apply(rgb, np.random.default_rng(seed), **options)


def noise_of(rgb, **changes):
    out = apply(only(shot_variance=1 / 24, read_noise=0.8, **changes), rgb).astype(float)
    return out.std(axis=(0, 1))


def test_ideal_passes_the_image_through_exactly():
    rgb = scene()
    out = apply(ColourErrorModel(IDEAL), rgb, pixel_motion=(20.0, 5.0))
    np.testing.assert_array_equal(out, rgb)
    assert out is not rgb and not np.shares_memory(out, rgb)


def test_input_is_not_changed():
    rgb = scene()
    before = rgb.copy()
    apply(only(defocus_px=1.0, motion_blur=True, read_noise=2.0), rgb, pixel_motion=(5, 5))
    np.testing.assert_array_equal(rgb, before)


def test_shot_noise_follows_the_number_of_electrons():
    np.testing.assert_allclose(noise_of(grey(200)), np.sqrt(0.8**2 + 200 / 24 + 1 / 12), rtol=0.05)
    np.testing.assert_allclose(noise_of(grey(100)), np.sqrt(0.8**2 + 100 / 24 + 1 / 12), rtol=0.05)


def test_night_is_noisier_than_day_on_a_surface_of_the_same_level():
    night, day = grey(5), grey(200)
    night[: H // 2], day[: H // 2] = 5, 5
    model = only(shot_variance=1 / 24, read_noise=0.8)

    def spread(rgb):
        return apply(model, rgb)[: H // 2].astype(float).std()

    assert spread(night) > 4 * spread(day)
    assert model.darkness(night) == 1.0 and model.darkness(day) == 0.0


def test_exposure_time_grows_in_the_dark():
    model = ColourErrorModel()
    times = [model.exposure_s(grey(level)) for level in (0, 12, 40, 80, 200)]
    assert times == sorted(times, reverse=True)
    assert times[0] == model.config.max_exposure_s and times[-1] == model.config.exposure_s


def test_noise_of_channels_and_frames_is_independent():
    rng, model = np.random.default_rng(0), only(read_noise=3.0)
    first, second = (model.apply(grey(128), rng).astype(float) - 128 for _ in range(2))

    def correlation(a, b):
        return abs(np.corrcoef(a.ravel(), b.ravel())[0, 1])

    assert correlation(first[..., 0], first[..., 1]) < 0.03
    assert correlation(first, second) < 0.03


def test_exposure_jitter_changes_brightness_per_frame():
    model, rng = only(exposure_jitter=0.1), np.random.default_rng(0)
    levels = [model.apply(grey(100), rng).mean() for _ in range(200)]
    assert np.std(np.log(levels)) == pytest.approx(0.1, rel=0.2)


def test_white_balance_stays_for_an_episode_and_leaves_green():
    model = ColourErrorModel(dataclasses.replace(IDEAL, white_balance_jitter=0.1))
    model.reset(np.random.default_rng(5))
    first, second = apply(model, grey(100), 1), apply(model, grey(100), 2)
    np.testing.assert_array_equal(first, second)
    red, green, blue = first[0, 0]
    assert green == 100 and red != 100 and blue != 100


def test_vignetting_darkens_corners_alike_and_leaves_the_middle():
    model = ColourErrorModel(dataclasses.replace(IDEAL, vignetting=0.5))
    model.reset(np.random.default_rng(1))
    out = apply(model, grey(200))[..., 1].astype(int)
    corners = [out[0, 0], out[0, -1], out[-1, 0], out[-1, -1]]
    assert out[H // 2, W // 2] == 200 and max(corners) < 200 and max(corners) - min(corners) <= 1
    assert min(corners) >= 100
    assert out[H // 2, 0] < out[0, W // 2], "the far ends of the image are darker than its near sides"


@pytest.mark.parametrize(("motion", "axis"), [((8.0, 0.0), 1), ((0.0, 8.0), 0)])
def test_motion_smears_an_edge_over_its_length_along_the_motion_only(motion, axis):
    rgb = grey(0)
    across = (slice(None), slice(W // 2, None)) if axis == 1 else (slice(H // 2, None), slice(None))
    rgb[across] = 240
    profile = apply(only(motion_blur=True), rgb, pixel_motion=motion)[..., 0].astype(float)
    line = profile[H // 2] if axis == 1 else profile[:, W // 2]
    grey_pixels = np.flatnonzero((line > 0) & (line < 240))
    assert len(grey_pixels) == pytest.approx(8, abs=1)
    assert grey_pixels.mean() == pytest.approx(len(line) / 2 - 0.5, abs=1.0)
    assert (np.diff(line) >= 0).all()
    assert profile.std(axis=1 - axis).max() == 0.0


def test_smear_repeats_the_border_and_keeps_a_flat_image():
    np.testing.assert_array_equal(apply(only(motion_blur=True), grey(77), pixel_motion=(30.0, -20.0)), grey(77))
    rgb = grey(0)
    rgb[:, :2] = (30, 60, 90)
    out = apply(only(motion_blur=True), rgb, pixel_motion=(4.0, 0.0))
    assert out[0, 0].tolist() == [30, 60, 90] or out[0, 0, 2] > out[0, 0, 1] > out[0, 0, 0] > 0


@pytest.mark.parametrize("length", [0.0, 0.5, 1.0, 3.0, 12.0, 1e6])
@pytest.mark.parametrize("angle", [0.0, 1.0, 2.5])
def test_trail_is_centred_and_no_longer_than_the_motion(length, angle):
    shifts = trail(length * np.array([np.cos(angle), np.sin(angle)]))
    assert np.abs(shifts.sum(axis=0)).max() <= len(shifts)
    assert np.abs(shifts).max() <= min(length, MAX_SMEAR_PX) / 2 + 0.5


@pytest.mark.parametrize("sigma_px", [0.2, 0.5, 1.0, 2.5])
def test_defocus_keeps_brightness_and_spreads_a_point(sigma_px):
    weights = blur_weights(sigma_px)
    assert 2 * weights.sum() - weights[0] == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_array_equal(apply(only(defocus_px=sigma_px * 2), grey(123)), grey(123))
    point = grey(0)
    point[100, 100] = 255
    out = apply(only(defocus_px=2.0), point)[..., 0].astype(float)  # 480-row pixels, so sigma is 1 here
    rows, columns = np.nonzero(out)
    assert out.sum() == pytest.approx(255, rel=0.1)
    spread = np.sqrt((out[rows, columns] * (columns - 100) ** 2).sum() / out.sum())
    assert spread == pytest.approx(1.0, abs=0.15)


def test_same_generator_state_same_image():
    model = ColourErrorModel()
    model.reset(np.random.default_rng(0))
    first = apply(model, scene(), 3, pixel_motion=(3, 4))
    apply(model, scene(1), 9)
    np.testing.assert_array_equal(apply(model, scene(), 3, pixel_motion=(3, 4)), first)
    assert not np.array_equal(apply(model, scene(), 4, pixel_motion=(3, 4)), first)


def test_a_frame_takes_the_same_random_numbers_whatever_is_configured():
    states = []
    for model in (ColourErrorModel(), ColourErrorModel(IDEAL)):
        rng = np.random.default_rng(0)
        model.reset(rng)
        model.apply(scene(), rng)
        states.append(rng.bit_generator.state)
    assert states[0] == states[1]


@pytest.mark.parametrize("shape", [(1, 1), (2, 700), (90, 3)])
def test_any_image_size_works(shape):
    out = apply(ColourErrorModel(), grey(100, shape), pixel_motion=(20.0, 20.0))
    assert out.shape == (*shape, 3) and out.dtype == np.uint8


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("rgb", {"rgb": scene().astype(float)}),
        ("rgb", {"rgb": scene()[..., :2]}),
        ("rgb", {"rgb": scene()[0]}),
        ("rgb", {"rgb": None}),
        ("rng", {"rng": 3}),
        ("pixel_motion", {"pixel_motion": (1.0, 2.0, 3.0)}),
        ("pixel_motion", {"pixel_motion": (np.nan, 0.0)}),
    ],
)
def test_bad_input_is_named(name, options):
    with pytest.raises(ValueError, match=f"^{name}"):
        ColourErrorModel().apply(**{"rgb": scene(), "rng": np.random.default_rng(0), **options})


def test_config_round_trips_through_json():
    config = ColourErrorConfig(read_noise=3.0, motion_blur=False)
    assert ColourErrorConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


@pytest.mark.parametrize(
    ("field", "value"),
    [("read_noise", -1), ("max_gain", 0.5), ("motion_blur", "yes"), ("unit_gain_level", 1.0), ("nois", 0)],
)
def test_wrong_config_is_named(field, value):
    with pytest.raises(ValueError, match=field):
        ColourErrorConfig.from_dict({field: value})
