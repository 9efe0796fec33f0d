import multiprocessing
import selectors
import threading
import time

import pytest

from stair_env.vectorized.wait import Watch


@pytest.mark.parametrize("with_poll", [True, False])
def test_tells_who_has_something_to_say(with_poll, monkeypatch):
    if not with_poll:
        monkeypatch.delattr(selectors, "PollSelector")
    watch, pipes = Watch(), [multiprocessing.Pipe() for _ in range(3)]
    for ours, _ in pipes:
        watch.add(ours)
    assert watch.ready(0.0) == []
    pipes[1][1].send("hello")
    pipes[2][1].close()
    assert set(watch.ready(1.0)) == {pipes[1][0], pipes[2][0]}
    assert pipes[1][0].recv() == "hello"
    assert watch.ready(1.0) == [pipes[2][0]]


@pytest.mark.parametrize("delay_s", [0.0, 0.02, 0.2])
def test_staying_awake_misses_nothing(delay_s):
    watch, (ours, theirs) = Watch(), multiprocessing.Pipe()
    watch.add(ours)
    sender = threading.Timer(delay_s, theirs.send, ["hello"])
    sender.start()
    assert watch.ready(5.0, awake_s=0.05) == [ours]
    sender.join()


def test_nobody_is_waited_for_longer_than_said():
    watch, (ours, _theirs) = Watch(), multiprocessing.Pipe()
    watch.add(ours)
    start = time.perf_counter()
    assert watch.ready(0.05, awake_s=0.05) == []
    assert 0.1 <= time.perf_counter() - start < 2.0
