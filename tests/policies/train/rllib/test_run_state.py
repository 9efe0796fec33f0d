"""What the environments of a run share: sums that do not depend on who counted, and one curriculum."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from policies.make_env import make_env
from policies.train.rllib.run_state import Flown, Moments, Report, Reporting, RunState
from stair_env.task.curriculum import Curriculum, CurriculumConfig


def counted(values: np.ndarray) -> Moments:
    moments = Moments(values.shape[1:])
    for value in values:
        moments.add(value)
    return moments


def test_moments_are_those_of_all_values_whoever_counted_them() -> None:
    values = np.random.default_rng(0).normal(3.0, [1.0, 50.0], (100, 2))
    merged = Moments((2,))
    for part in np.split(values, [10, 10, 73]):
        merged.merge(counted(part))
    assert merged.count == 100
    np.testing.assert_allclose(merged.mean, values.mean(0))
    np.testing.assert_allclose(merged.var, values.var(0))
    restored = Moments.restored(json.loads(json.dumps(merged.state())))
    assert restored.count == 100 and np.array_equal(restored.var, merged.var)
    assert np.array_equal(Moments((2,)).var, np.ones(2))


def run_state(num_envs: int = 4, curriculum: Curriculum | None = None) -> RunState:
    return RunState({"proprio": Moments((3,))}, curriculum, num_envs)


def report(*episodes: Flown) -> Report:
    return Report({"proprio": Moments((3,))}, Moments(), list(episodes))


def test_one_curriculum_listens_to_all_environments() -> None:
    run = run_state(num_envs=12, curriculum=Curriculum(CurriculumConfig(window=4), 0.17))
    assert run.curriculum is not None and run.curriculum.config.window == 12  # an episode of each at least
    run.absorb([report(*[Flown(True, 1.0, 10, 0)] * 5), report(*[Flown(True, 1.0, 10, 0)] * 5)])
    assert run.curriculum.level == 0
    run.absorb([report(*[Flown(True, 1.0, 10, 0)] * 30)])
    assert run.curriculum.level == 1  # a level an iteration: the other episodes were of the level before
    run.absorb([report(*[Flown(False, 1.0, 10, 0)] * 30)])
    assert run.curriculum.level == 1 and run.curriculum_state() == {"level": 1, "results": []}
    assert run.episodes == 70


def test_a_state_goes_on_where_it_was_written() -> None:
    run = run_state(curriculum=Curriculum(CurriculumConfig(), 0.17))
    run.observations["proprio"].add(np.arange(3.0))
    run.absorb([report(Flown(True, 2.5, 10, 0), Flown(False, 1.5, 7, 0))])
    again = run_state(curriculum=Curriculum(CurriculumConfig(), 0.17))
    again.restore(json.loads(json.dumps(run.state())))
    assert again.state() == run.state() and again.recent[0] == Flown(True, 2.5, 10, 0)


def test_an_environment_reports_what_it_met(toy_id: str) -> None:
    env = Reporting(make_env(toy_id, monitor=False), ("proprio",), gamma=0.5, norm_reward=True)
    plain = make_env(toy_id, monitor=False)
    seen = [env.reset(seed=3)[0]["proprio"]]
    plain.reset(seed=3)
    env.share({"level": 7, "results": []}, return_var=4.0)
    rewards, discounted, returns = [], 0.0, []
    for _ in range(10):
        action = np.zeros(2, np.float32)
        observation, scaled, terminated, _, info = env.step(action)
        reward = plain.step(action)[1]
        assert scaled == pytest.approx(float(reward) / 2.0) and info == {}
        seen.append(observation["proprio"])
        rewards.append(float(reward))
        discounted = 0.5 * discounted + float(reward)
        returns.append(discounted)
    assert terminated
    met = env.collect()
    np.testing.assert_allclose(met.observations["proprio"].mean, np.mean(seen, axis=0), rtol=1e-6)
    assert met.returns.var == pytest.approx(np.var(returns))
    assert met.episodes == [Flown(rewards[-1] > -0.5, pytest.approx(sum(rewards)), 10, 0)]
    assert env.reset()[1] == {} and env.collect().episodes == []
    base: Any = env.unwrapped
    assert base.curriculum.level == 8  # that which was shared, and the toy's own step
