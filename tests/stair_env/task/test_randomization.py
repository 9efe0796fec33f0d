import numpy as np
import pytest

from stair_env.common.validation import SpecError
from stair_env.task.randomization import NOMINAL, Randomization, read_randomization


def test_options_name_what_is_wrong():
    assert read_randomization(None).push_speed == 0.0
    assert read_randomization(True).push_speed > 0.0
    with pytest.raises(SpecError, match="friction"):
        read_randomization({"friction": (2.0, 1.0)})
    with pytest.raises(SpecError, match="randomization"):
        read_randomization("lots")


def test_bodies_lie_in_their_ranges_and_the_nominal_one_never_varies():
    ranges = Randomization()
    for seed in range(20):
        body = ranges.draw(np.random.default_rng(seed))
        assert ranges.friction[0] <= body.friction <= ranges.friction[1]
        assert ranges.payload_kg[0] <= body.payload_kg <= ranges.payload_kg[1]
        assert NOMINAL.draw(np.random.default_rng(seed)) == (0.9, 0.0, 1.0)
