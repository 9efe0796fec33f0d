"""The map of nosings by itself."""

import math

import pytest

from perception.geometry.results import Nosing
from perception.tracking.nosing_filter import NosingMap

TREAD = 0.32


def seen(distance: float, tread: float | None = None) -> Nosing:
    return Nosing(distance, 0.005, 0.0, 0.005, 0.14, 0.003, tread, None if tread is None else 0.005)


@pytest.mark.parametrize("beyond", [0.21, 0.26, 0.45])
@pytest.mark.parametrize("looks", [1, 2, 3])
def test_a_tread_up_to_what_was_never_there_is_forgotten_with_it(beyond: float, looks: int) -> None:
    """A stripe on the floor below the last nosing of a flight: for a frame or three it seems to end one more tread."""
    nosings = NosingMap()
    flight = (seen(0.5, TREAD), seen(0.5 + TREAD, TREAD), seen(0.5 + 2 * TREAD))
    for _ in range(10):
        nosings.update(flight, 0.0)
    last = len(nosings) - 1
    assert math.isinf(nosings.tread.std_at(last))
    for _ in range(looks):
        nosings.update((*flight[:-1], seen(flight[-1].distance_m, beyond), seen(flight[-1].distance_m + beyond)), 0.0)
    assert len(nosings) == len(flight) + 1 and nosings.tread.at(last, 0.0) == pytest.approx(beyond, abs=0.01)
    for _ in range(2 * looks + 4):
        nosings.update(flight, 0.0, clear_m=2.0)
    assert len(nosings) == len(flight)
    assert nosings.tread.at(last, 0.0) == pytest.approx(TREAD, abs=0.005)
    assert nosings.tread.at(0, 0.0) == pytest.approx(TREAD, abs=0.005)


def test_a_tread_stays_known_when_its_end_is_left_behind() -> None:
    nosings = NosingMap()
    for _ in range(5):
        nosings.update((seen(0.1, TREAD), seen(0.1 + TREAD, TREAD), seen(0.1 + 2 * TREAD, TREAD)), 0.0)
    nosings.advance(0.3)
    nosings.forget_behind(0.1)
    assert len(nosings) == 2
    assert [nosings.tread.std_at(i) < 0.01 for i in range(2)] == [True, True]
