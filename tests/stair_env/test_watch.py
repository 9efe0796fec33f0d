import multiprocessing
import selectors

import pytest

from stair_env.watch import Watch


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
