import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from perception.learning.losses import (
    GridTargets,
    LossWeights,
    detection_loss,
    location_errors,
    total_loss,
)
from perception.network import RawOutput


def batch(cells: int = 3, seed: int = 0) -> tuple[RawOutput, GridTargets]:
    generator = torch.Generator().manual_seed(seed)
    cls = torch.zeros(2, 1, 4, 4)
    cls.view(-1)[:cells] = 1.0
    loc = torch.rand(2, 8, 4, 4, generator=generator)
    logits = torch.randn(2, 1, 4, 4, generator=generator)
    return RawOutput(logits, torch.rand(2, 8, 4, 4, generator=generator)), GridTargets(cls, loc * cls)


def test_terms_are_named_and_perfect_location_costs_nothing():
    raw, targets = batch()
    terms = detection_loss(RawOutput(raw.cls_logits, targets.loc), targets)
    assert set(terms) == {"cls", "x", "y"}
    assert terms["x"] == terms["y"] == 0
    assert terms["cls"] > 0


@pytest.mark.parametrize("kind", ["l1", "l2"])
def test_empty_cells_have_no_location_loss(kind):
    raw, targets = batch(cells=0)
    raw.loc.requires_grad_()
    terms = detection_loss(raw, targets, kind)
    total_loss(terms, LossWeights()).backward()
    assert terms["x"] == terms["y"] == 0
    assert (raw.loc.grad == 0).all()


def test_x_and_y_are_told_apart():
    raw, targets = batch()
    shifted = targets.loc.clone()
    shifted[:, 1::2] += 0.1  # y1 y2 y3 y4
    terms = detection_loss(RawOutput(raw.cls_logits, shifted), targets, "l1")
    assert terms["x"] == 0
    assert terms["y"] == pytest.approx(0.1 * 4 * 3 / 32, rel=1e-5)  # four coordinates, 3 of 2 x 16 cells


def test_equation_2_is_equation_1_with_its_fixed_weights():
    raw, targets = batch()
    terms = detection_loss(raw, targets)
    by_equation_1 = terms["cls"] + 4.0 * (terms["x"] + 4.0 * terms["y"])
    torch.testing.assert_close(total_loss(terms, LossWeights.fixed(4.0, 4.0)), by_equation_1)


def test_location_errors_count_true_cells_only():
    _, targets = batch()
    predicted = targets.loc + 0.25
    x, y = location_errors(predicted, targets)
    assert x == pytest.approx(0.25 * 4 * 3)
    assert y == pytest.approx(x)


@given(st.floats(0, 1e6), st.floats(0, 1e6))
def test_update_moves_weight_to_the_larger_error_and_keeps_the_sum(x_error, y_error):
    before = LossWeights()
    after = before.updated(x_error, y_error)
    assert after.x + after.y == pytest.approx(before.x + before.y)
    assert (after.x - before.x) * (x_error - y_error) >= 0
    assert abs(after.x - before.x) <= 1.0


def test_equations_5_and_6():
    after = LossWeights(10.0, 10.0).updated(3.0, 4.0)
    assert after.x == pytest.approx(9.75)
    assert after.y == pytest.approx(10.25)


def test_weights_never_fall_below_sigma():
    weights = LossWeights()
    for _ in range(50):
        weights = weights.updated(0.0, 1.0)
        assert min(weights.x, weights.y) >= 0.5
    stuck = LossWeights(0.6, 19.4)
    assert stuck.updated(0.0, 1.0) == stuck


def test_wrong_arguments():
    raw, targets = batch()
    with pytest.raises(ValueError, match="l1, l2"):
        detection_loss(raw, targets, "huber")
    with pytest.raises(ValueError, match="x=-1"):
        LossWeights(-1.0, 1.0)
    with pytest.raises(ValueError, match="y=nan"):
        LossWeights(1.0, float("nan"))


def test_the_best_constant_score_under_a_positive_weight_lies_where_the_docstring_says():
    share, weight = 1.0 / 3.0, 2.0  # a probability of 1 / (1 + w) must score exactly 0.5
    cls = torch.zeros(1, 1, 3, 2)
    cls[0, 0, 0] = 1.0
    assert float(cls.mean()) == pytest.approx(share)
    logit = torch.zeros(1, requires_grad=True)
    raw = RawOutput(logit.expand(1, 1, 3, 2), torch.zeros(1, 8, 3, 2))
    terms = detection_loss(raw, GridTargets(cls, torch.zeros(1, 8, 3, 2)), positive_weight=weight)
    terms["cls"].backward()
    assert float(logit.grad) == pytest.approx(0.0, abs=1e-6)
