import pytest

from stair_env.observation import STAIR_FIELDS
from stair_env.task.block_error import block_error

TRUTH = {"valid": 1.0, "step_width": 0.30, "step_height": 0.15, "edge_distance": 0.50}


def block(**changes):
    values = {**dict.fromkeys(STAIR_FIELDS, 0.0), **TRUTH, **changes}
    return [values[name] for name in STAIR_FIELDS]


def test_differences_are_measured_minus_true():
    error = block_error(block(step_width=0.31, step_height=0.14, edge_distance=0.52), TRUTH)
    assert error[:3] == pytest.approx((0.01, -0.01, 0.02)) and error.same_edge


@pytest.mark.parametrize(("distance", "same"), [(0.64, True), (0.66, False), (0.36, True), (0.34, False)])
def test_within_half_a_tread_both_speak_of_the_same_edge(distance, same):
    assert block_error(block(edge_distance=distance), TRUTH).same_edge is same


def test_a_block_without_stairs_has_no_error():
    assert block_error(block(valid=0.0), TRUTH) is None
