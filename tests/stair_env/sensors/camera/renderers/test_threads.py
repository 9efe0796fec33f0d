"""Work is done once, all of it, and whoever asked learns how it went."""

import threading

import numpy as np
import pytest

from stair_env.sensors.camera.renderers import threads


@pytest.mark.parametrize("count", [1, 2, 5])
def test_every_row_is_worked_on_once(count):
    seen = []
    threads.run_rows(seen.extend, 23, count)
    assert sorted(seen) == list(range(23))


@pytest.mark.parametrize("count", [1, 2])
def test_later_gives_the_result(count, monkeypatch):
    monkeypatch.setattr(threads, "default_threads", lambda: count)
    workers = []
    result = threads.later(lambda: workers.append(threading.current_thread()) or np.arange(3))
    np.testing.assert_array_equal(result(), np.arange(3))
    assert (workers[0] is threading.current_thread()) == (count == 1)


@pytest.mark.parametrize("count", [1, 2])
def test_later_raises_what_the_work_raised(count, monkeypatch):
    monkeypatch.setattr(threads, "default_threads", lambda: count)
    result = threads.later(lambda: np.ones(2) @ np.ones(3))
    with pytest.raises(ValueError, match="mismatch"):
        result()


def test_rows_do_not_wait_for_a_thread_that_does_other_work(monkeypatch):
    monkeypatch.setattr(threads, "default_threads", lambda: 2)
    hold = threading.Event()
    other = threads.later(lambda: np.array(hold.wait(30)))
    seen = []
    threads.run_rows(seen.extend, 23, 2)
    assert sorted(seen) == list(range(23)) and not hold.is_set()
    hold.set()
    assert other()
