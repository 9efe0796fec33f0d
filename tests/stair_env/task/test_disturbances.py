import numpy as np

from stair_env.task.disturbances import CommandLatency, Pushes


def test_commands_come_late_as_often_as_asked():
    latency = CommandLatency(0.3)
    latency.reset(np.full(12, -1.0), np.random.default_rng(0))
    planned = [np.full(12, float(k)) for k in range(2000)]
    delay = [float(k - latency.deliver(targets)[0]) for k, targets in enumerate(planned)]
    assert set(delay) == {0.0, 1.0} and 0.25 < np.mean(delay) < 0.35


def test_without_latency_no_number_is_drawn():
    rng, untouched = np.random.default_rng(0), np.random.default_rng(0)
    latency = CommandLatency(0.0)
    latency.reset(np.zeros(12), rng)
    targets = np.ones(12)
    assert latency.deliver(targets) is targets and rng.random() == untouched.random()


def test_pushes_are_horizontal_bounded_and_as_frequent_as_asked():
    pushes, found = Pushes(0.2, 0.5), []
    pushes.reset(np.random.default_rng(1))
    for k in range(48 * 200):
        push = pushes.due(k / 48)
        if push is not None:
            found.append(push)
    assert 330 < len(found) < 450
    assert np.abs(found).max() <= 0.2 and not np.array(found)[:, 2].any()


def test_no_interval_means_no_push():
    pushes = Pushes(0.2, 0.0)
    pushes.reset(np.random.default_rng(0))
    assert all(pushes.due(float(t)) is None for t in range(10_000))
