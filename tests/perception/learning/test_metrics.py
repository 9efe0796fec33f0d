import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perception.data.label_grid import encode_grid
from perception.learning.metrics import DetectionCounts, count_cells, endpoint_score, line_confidence

LINES = np.array([[20.0, 100.0, 480.0, 130.0], [40.0, 300.0, 470.0, 280.0]])


def truth():
    grid = encode_grid(LINES)
    return grid.cls[None], grid.loc[None]


def test_perfect_detection_is_a_hundred_per_cent():
    cls, loc = truth()
    counts = count_cells(cls, loc, cls, loc)
    assert (counts.accuracy, counts.recall, counts.iou, counts.frames) == (100.0, 100.0, 100.0, 1)


def test_known_counts():
    cls, loc = truth()
    predicted = cls.copy()
    holds = np.argwhere(cls[0] > 0)
    predicted[0][tuple(holds[0])] = 0.2  # one missed
    predicted[0, 0, 0] = 0.9  # one invented
    far = loc.copy()
    far[0][tuple(holds[1])] = 1.0 - far[0][tuple(holds[1])]  # one found in the wrong place
    counts = count_cells(predicted, far, cls, loc)
    assert counts.true_positives == len(holds) - 2
    assert counts.false_positives == 2
    assert counts.false_negatives == 1
    assert counts.iou == pytest.approx(100 * (len(holds) - 2) / (len(holds) + 1))


def test_confidence_formula_of_stairnet():
    assert endpoint_score(np.array(0.0)) == pytest.approx(1.0)
    assert endpoint_score(np.array(1.0)) == pytest.approx(0.0)
    assert endpoint_score(np.array(1.5)) == 0.0
    assert endpoint_score(np.array(0.5)) == pytest.approx((np.e - 1) / (np.e**2 - 1))


@given(st.floats(0, 2), st.floats(0, 2))
def test_nearer_endpoints_score_higher(a, b):
    near, far = sorted((a, b))
    assert endpoint_score(np.array(near)) >= endpoint_score(np.array(far))


def test_order_of_the_two_lines_does_not_matter():
    rng = np.random.default_rng(0)
    true = rng.random((5, 8))
    swapped = true[:, [4, 5, 6, 7, 0, 1, 2, 3]]
    np.testing.assert_allclose(line_confidence(swapped, true), 1.0)


def test_swapped_ends_are_not_the_same_line():
    true = np.array([0.0, 0.1, 1.0, 0.9] * 2)
    swapped = np.array([1.0, 0.9, 0.0, 0.1] * 2)
    assert line_confidence(swapped, true) < 0.5


def test_counts_add_up_and_nothing_is_zero_per_cent():
    a, b = DetectionCounts(3, 1, 2, 1), DetectionCounts(1, 1, 0, 2)
    assert a + b == DetectionCounts(4, 2, 2, 3)
    assert DetectionCounts().iou == DetectionCounts().accuracy == DetectionCounts().recall == 0.0


def test_shapes_are_checked():
    cls, loc = truth()
    with pytest.raises(ValueError, match="shapes differ"):
        count_cells(cls, loc[..., :4], cls, loc)
