import numpy as np
import pytest

from perception.data.augmentation import AugmentationConfig, augment, mirrored, shifted, turned
from perception.data.stair_dataset import Sample


def frame() -> Sample:
    """A white line on grey, where the label says it is."""
    rng = np.random.default_rng(0)
    rgb = rng.integers(60, 90, (512, 512, 3)).astype(np.uint8)
    rgb[200, 100:300] = 255
    depth = np.full((512, 512), 2.0, np.float32)
    depth[:200] = 3.0
    return Sample(rgb, depth, np.array([0]), np.array([[100.0, 200.5, 300.0, 200.5]]))


def marked_row_and_columns(sample: Sample) -> tuple[int, int, int]:
    rows, columns = np.nonzero((sample.rgb == 255).all(-1))
    return int(rows[0]), int(columns.min()), int(columns.max()) + 1


@pytest.mark.parametrize("change", [mirrored, lambda s: shifted(s, 17, -9), lambda s: shifted(s, -30, 12)])
def test_labels_follow_the_image(change):
    changed = change(frame())
    row, left, right = marked_row_and_columns(changed)
    np.testing.assert_allclose(changed.lines, [[left, row + 0.5, right, row + 0.5]])
    assert changed.depth_m[row, left] == 2.0
    assert changed.depth_m[row - 1, left] == 3.0


def test_mirroring_twice_is_nothing():
    twice = mirrored(mirrored(frame()))
    np.testing.assert_array_equal(twice.rgb, frame().rgb)
    np.testing.assert_array_equal(twice.lines, frame().lines)


def test_what_comes_in_is_empty():
    moved = shifted(frame(), 20, 10)
    assert (moved.rgb[:10] == 0).all()
    assert (moved.depth_m[:, :20] == 0).all()


def test_never_loses_both_modalities_and_loses_each_as_often_as_asked():
    config = AugmentationConfig(drop_colour=0.3, drop_depth=0.3, corrupt_depth=0.0, other_depth=0.0)
    rng = np.random.default_rng(1)
    black = missing = 0
    small = Sample(frame().rgb[:64, :64], frame().depth_m[:64, :64], np.zeros(0), np.zeros((0, 4)))
    for _ in range(300):
        changed = augment(small, config, rng)
        no_colour, no_depth = not changed.rgb.any(), not changed.depth_m.any()
        assert not (no_colour and no_depth)
        black, missing = black + no_colour, missing + no_depth
    assert 60 < black < 120
    assert 60 < missing < 120


def test_same_generator_same_result_and_the_original_stays():
    sample, untouched = frame(), frame()
    config = AugmentationConfig(photometric=1.0, noise=1.0, blur=1.0, smear=1.0, jpeg=1.0, corrupt_depth=1.0)
    a, b = (augment(sample, config, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(a.rgb, b.rgb)
    np.testing.assert_array_equal(a.depth_m, b.depth_m)
    np.testing.assert_array_equal(sample.rgb, untouched.rgb)
    np.testing.assert_array_equal(sample.depth_m, untouched.depth_m)


@pytest.mark.parametrize(("degrees", "scale"), [(10.0, 1.0), (-7.0, 1.3), (3.0, 0.8)])
def test_labels_turn_with_the_image(degrees, scale):
    changed = turned(frame(), degrees, scale)
    (x1, y1, x2, y2), white = changed.lines[0], (changed.rgb > 150).all(-1)
    v, u = np.nonzero(white)
    slope = (y2 - y1) / (x2 - x1)
    off = (v + 0.5) - (y1 + slope * (u + 0.5 - x1))
    assert np.abs(off).max() < 1.2 * max(scale, 1.0)  # the line is a pixel high
    assert abs(off.mean()) < 0.2
    assert abs(u.min() - x1) < 2.5 and abs(u.max() - x2) < 2.5


def test_another_frames_depth_and_depth_that_says_nothing():
    other = np.full((512, 512), 7.0, np.float32)
    off = {"corrupt_depth": 0.0, "drop_colour": 0.0, "drop_depth": 0.0}
    swapped = augment(frame(), AugmentationConfig(other_depth=1.0, meaningless_depth=0.0, **off),
                      np.random.default_rng(0), lambda: other)  # fmt: skip
    assert swapped.depth_m is other
    vague = augment(
        frame(), AugmentationConfig(other_depth=0.0, meaningless_depth=1.0, **off), np.random.default_rng(0)
    )
    assert (vague.depth_m > 0.0).all()
    assert not np.isin(vague.depth_m, (2.0, 3.0)).any()


def test_in_the_dark_depth_is_mostly_kept():
    dark = Sample(np.zeros((64, 64, 3), np.uint8), np.ones((64, 64), np.float32), np.zeros(0), np.zeros((0, 4)))
    config = AugmentationConfig(
        drop_depth=0.9, drop_colour=0.0, other_depth=0.0, corrupt_depth=0.0, shift=0.0, turn=0.0
    )
    kept = sum(augment(dark, config, np.random.default_rng(seed)).depth_m.any() for seed in range(200))
    assert 100 < kept < 180


def test_black_stays_black_under_photometric_changes():
    dark = Sample(np.zeros((64, 64, 3), np.uint8), np.ones((64, 64), np.float32), np.zeros(0), np.zeros((0, 4)))
    config = AugmentationConfig(photometric=1.0, noise=0.0, shift=0.0, jpeg=0.0)
    for seed in range(5):
        assert not augment(dark, config, np.random.default_rng(seed)).rgb.any()


def test_the_papers_augmentation_mirrors_only():
    for seed in range(8):
        changed = augment(frame(), AugmentationConfig.paper(), np.random.default_rng(seed))
        same = np.array_equal(changed.rgb, frame().rgb) and np.array_equal(changed.depth_m, frame().depth_m)
        assert same or np.array_equal(changed.rgb, mirrored(frame()).rgb)


@pytest.mark.parametrize(
    "wrong", [{"mirror": 1.5}, {"drop_colour": 0.6, "drop_depth": 0.6}, {"turn_scale": (2.0, 1.0)}, {"turn_deg": 90.0}]
)
def test_wrong_values_are_named(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        AugmentationConfig(**wrong)
