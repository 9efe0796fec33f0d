import numpy as np
import pytest

from perception.data.depth_corruption import CORRUPTIONS, corrupt_depth, meaningless_depth


def steps() -> np.ndarray:
    """Risers and treads seen from before them, float32 (256, 320) metres, with a hole."""
    depth = np.repeat(np.linspace(3.0, 1.0, 256, dtype=np.float32)[:, None], 320, 1)
    depth += 0.2 * ((np.arange(256) // 32) % 2)[:, None].astype(np.float32)
    depth[100:130, 50:90] = 0.0
    return depth


@pytest.mark.parametrize("name", CORRUPTIONS)
@pytest.mark.parametrize("seed", range(4))
def test_each_changes_depth_and_leaves_its_argument_alone(name, seed):
    depth, untouched = steps(), steps()
    changed = CORRUPTIONS[name][0](depth, np.random.default_rng(seed))
    np.testing.assert_array_equal(depth, untouched)
    assert changed.shape == depth.shape
    assert np.isfinite(changed).all() and (changed >= 0.0).all() and (changed < 60.0).all()
    if name != "left band missing":  # may draw no side
        assert not np.array_equal(changed, depth)


@pytest.mark.parametrize("name", ["blurred", "waves", "noisy", "coarse steps", "rescaled"])
def test_what_changes_values_invents_no_readings(name):
    depth = steps()
    for seed in range(4):
        assert not CORRUPTIONS[name][0](depth, np.random.default_rng(seed))[depth == 0.0].any()


def test_nothing_in_nothing_out():
    nothing = np.zeros((64, 96), np.float32)
    for name, (corruption, _) in CORRUPTIONS.items():
        changed = corruption(nothing, np.random.default_rng(0))
        assert np.isfinite(changed).all()
        assert name == "sparks" or not changed.any()


def test_same_generator_same_depth():
    a, b = (corrupt_depth(steps(), np.random.default_rng(9)) for _ in range(2))
    np.testing.assert_array_equal(a, b)
    assert a.dtype == np.float32
    assert not np.array_equal(a, corrupt_depth(steps(), np.random.default_rng(10)))


def test_meaningless_depth_is_a_possible_reading_everywhere():
    for seed in range(30):
        depth = meaningless_depth((64, 96), np.random.default_rng(seed))
        assert depth.shape == (64, 96) and depth.dtype == np.float32
        assert (depth > 0.1).all() and (depth < 12.0).all()
