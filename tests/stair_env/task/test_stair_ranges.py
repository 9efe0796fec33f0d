import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stair_env.common.validation import SpecError
from stair_env.task.stair_ranges import StairRanges


@given(st.integers(0, 10_000))
def test_drawn_stairs_lie_in_their_ranges(seed):
    ranges = StairRanges("both", (0.1, 0.15), (0.26, 0.3), (3, 6), uneven=0.01)
    spec = ranges.draw(np.random.default_rng(seed), None)
    assert spec.direction in ("up", "down")
    assert 0.1 <= spec.riser_height <= 0.15 and 0.26 <= spec.tread_depth <= 0.3 and 3 <= spec.num_steps <= 6
    assert np.abs(spec.riser_offsets).max() <= 0.01
    assert spec == ranges.draw(np.random.default_rng(seed), None)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("riser_height", -1),
        ("riser_height", (0.2, 0.1)),
        ("riser_height", (0.1, 0.12, 0.14)),
        ("riser_height", "high"),
        ("num_steps", 2.5),
        ("direction", "sideways"),
        ("tread_depth", True),
    ],
)
def test_wrong_ranges_are_named(field, value):
    with pytest.raises(SpecError, match=field):
        StairRanges(**{field: value})
