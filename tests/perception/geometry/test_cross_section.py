"""Nosings read from a cross-section, and how the steps of one flight support each other."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perception.geometry.cross_section import DOWN, SURE_RUN, UNEVENNESS_STD_M, Section, _steady, read_nosings
from perception.geometry.lines import LineSlopes
from perception.geometry.results import Nosing
from perception.geometry.strips.strip_labels import TREAD

OMEGA = 0.05


def flight(treads_m: list[float], stds_m: list[float]) -> tuple[Nosing, ...]:
    return tuple(
        Nosing(0.5 + 0.3 * i, 0.01, -0.5, 0.01, tread_m=tread, tread_std_m=std)
        for i, (tread, std) in enumerate(zip(treads_m, stds_m))
    )


def treads(nosings: tuple[Nosing, ...]) -> np.ndarray:
    return np.array([nosing.tread_m for nosing in nosings])


LENGTHS = st.lists(st.tuples(st.floats(0.24, 0.36), st.floats(1e-4, 0.03)), min_size=2, max_size=6)


@given(LENGTHS)
def test_lengths_stay_between_their_neighbours_and_get_no_less_certain(drawn: list[tuple[float, float]]) -> None:
    lengths, stds = [pair[0] for pair in drawn], [pair[1] for pair in drawn]
    steadied = _steady(flight(lengths, stds))
    assert treads(steadied).min() >= min(lengths) - 1e-12
    assert treads(steadied).max() <= max(lengths) + 1e-12
    assert all(nosing.tread_std_m <= std + 1e-12 for nosing, std in zip(steadied, stds))  # type: ignore[operator]


def test_uneven_steps_that_are_well_seen_stay_uneven() -> None:
    uneven = [0.29, 0.31, 0.30, 0.28]
    assert treads(_steady(flight(uneven, [0.001] * 4))) == pytest.approx(uneven, abs=2e-4)


def test_a_badly_seen_step_leans_on_the_others() -> None:
    steadied = treads(_steady(flight([0.30, 0.30, 0.35], [0.002, 0.002, 2.0 * UNEVENNESS_STD_M])))
    assert steadied[2] < 0.32
    assert steadied[:2] == pytest.approx([0.30, 0.30], abs=1e-3)


def test_a_step_alone_and_unknown_lengths_stay_as_they_are() -> None:
    alone = flight([0.30], [0.02])
    assert _steady(alone) == alone
    unknown = (Nosing(0.5, 0.01, -0.5, 0.01), *alone)
    assert _steady(unknown) == unknown


@pytest.mark.parametrize("spread", [0.5, 1.0])
def test_errors_shrink_as_the_stated_deviation_says(spread: float) -> None:
    """Flights drawn as the prior has them, seen with known noise: the answer's errors have the stated size."""
    rng = np.random.default_rng(3)
    noise = spread * UNEVENNESS_STD_M
    ratio, raw, better = [], [], []
    for _ in range(300):
        true = 0.30 + rng.normal(0.0, UNEVENNESS_STD_M, 4)
        seen = true + rng.normal(0.0, noise, 4)
        steadied = _steady(flight(seen.tolist(), [noise] * 4))
        stds = np.array([nosing.tread_std_m for nosing in steadied])
        error = treads(steadied) - true
        ratio.append(error / stds)
        raw.append(seen - true)
        better.append(error)
    assert np.std(ratio) == pytest.approx(1.0, abs=0.1)
    assert np.std(better) < 0.97 * np.std(raw)


def nosings_of(tread: float, riser: float, near: tuple[float, float], slope_std: float):
    """Of a flight down from (forward, height) `near`, its lines known to slope_std and its heights exactly."""
    count = 4
    forward = near[0] + tread * np.arange(count)
    height = near[1] - riser * np.arange(count)
    section = Section(np.full(count, TREAD), height, np.eye(count) * 1e-8, np.arange(count), np.arange(count))
    slopes = LineSlopes(height / forward, np.full(count, slope_std), np.ones(count, bool))
    faces = SimpleNamespace(angle_cov=np.diag([1e-6] * 3))
    nosings, _ = read_nosings(section, DOWN, slopes, faces, OMEGA)
    return nosings


@pytest.mark.parametrize(("tread", "riser"), [(0.15, 0.075), (0.2, 0.1)])
def test_a_narrow_tread_is_believed_only_where_it_is_sure(tread: float, riser: float) -> None:
    for slope_std, believed in ((0.0005, True), (0.006, False)):
        nosings = nosings_of(tread, riser, (1.2, -1.2), slope_std)
        assert (nosings[0].tread_m is not None) == believed
        assert (nosings[0].riser_m is not None) == believed


def test_the_same_lines_nearby_are_believed() -> None:
    nosing = nosings_of(0.2, 0.1, (0.3, -0.7), 0.006)[0]
    assert (nosing.tread_m, nosing.riser_m) == pytest.approx((0.2, 0.1), abs=1e-6)


def test_usual_treads_known_no_better_are_believed() -> None:
    nosing = nosings_of(0.29, 0.16, (1.4, -1.2), 0.005)[0]
    assert nosing.tread_std_m > SURE_RUN * 0.29
    assert nosing.tread_m == pytest.approx(0.29, abs=1e-6)
