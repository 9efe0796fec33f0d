"""Environments in worker processes: the same as Gymnasium's own vector, and never silent about a worker's end."""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cloudpickle
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import stair_env
from stair_env.common.validation import SpecError
from stair_env.vector import WorkerVectorEnv, make_worker_vec
from stair_env.vectorized.pool import WorkerError

cloudpickle.register_pickle_by_value(sys.modules[__name__])  # workers need not be able to import the tests

PLAIN, RGBD = "stair_env/StairClimb-v0", "stair_env/StairClimbRGBD-v0"
KILL, EXIT, RAISE, SLEEP, LONG = 1.0, 2.0, 3.0, 4.0, 7  # first component of Toy's action; steps of an episode


class Toy(gym.Env):
    """Counts its steps, ends at random, and does the harm that its action asks for."""

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(self, size: int = 3) -> None:
        self.observation_space = gym.spaces.Dict(
            {
                "state": gym.spaces.Box(-np.inf, np.inf, (size,), np.float32),
                "rgb": gym.spaces.Box(0, 255, (4, 5, 3), np.uint8),
            }
        )
        self.action_space = gym.spaces.Box(-9.0, 9.0, (2,), np.float32)
        self.size, self.label, self.has_torch = size, "toy", "torch" in sys.modules

    def _observe(self) -> dict[str, np.ndarray]:
        state = self.np_random.normal(size=self.size).astype(np.float32)
        return {"state": state, "rgb": self.np_random.integers(0, 256, (4, 5, 3), np.uint8)}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.count = (options or {}).get("count", 0)
        return self._observe(), {"count": self.count, "terms": {"first": 1.0}}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        if action[0] == KILL:
            os.kill(os.getpid(), signal.SIGKILL)
        if action[0] == EXIT:
            os._exit(7)
        if action[0] == RAISE:
            raise ValueError("the stairs are gone")
        if action[0] == SLEEP:
            time.sleep(60)
        self.count += 1
        ended = bool(self.np_random.random() < 0.15)
        info = {"count": self.count, "terms": {"first": float(action[1]), "last": 2.0}, "name": f"step {self.count}"}
        return self._observe(), float(action.sum()), ended, self.count >= LONG, info

    def lock(self) -> Any:
        return threading.Lock()  # cannot be pickled

    def double(self, number: int) -> int:
        return 2 * number


def make_toys(number: int = 5, **kwargs: Any) -> WorkerVectorEnv:
    return WorkerVectorEnv([Toy] * number, **{"context": "fork", "workers": 2, **kwargs})


@pytest.fixture()
def toys() -> Iterator[WorkerVectorEnv]:
    env = make_toys()
    env.reset(seed=0)
    yield env
    env.close()


def assert_same(ours: Any, theirs: Any) -> None:
    """Equal trees of dicts and arrays, keys and types included."""
    assert type(ours) is type(theirs)
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys()
        for key in ours:
            assert_same(ours[key], theirs[key])
    elif isinstance(ours, tuple):
        for a, b in zip(ours, theirs, strict=True):
            assert_same(a, b)
    elif isinstance(ours, np.ndarray) and ours.dtype == object:
        assert_same(tuple(ours), tuple(theirs))
    elif isinstance(ours, np.ndarray):
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs)
    else:
        assert ours == theirs


@pytest.mark.parametrize("caller_steps", [False, True])
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_is_gymnasiums_own_vector_infos_included(mode: AutoresetMode, caller_steps: bool) -> None:
    ours = make_toys(autoreset_mode=mode, caller_steps=caller_steps)
    assert len(ours.pool.pids) == 2 - caller_steps
    theirs = SyncVectorEnv([Toy] * 5, autoreset_mode=mode)
    assert ours.metadata == theirs.metadata and ours.metadata["autoreset_mode"] is mode
    assert ours.observation_space == theirs.observation_space and ours.action_space == theirs.action_space
    rng, ends = np.random.default_rng(0), 0
    assert_same(ours.reset(seed=4), theirs.reset(seed=4))
    for _ in range(40):
        actions = rng.uniform(-0.9, 0.9, (5, 2)).astype(np.float32)
        step = ours.step(actions)
        assert_same(step, theirs.step(actions))
        ends += int((step[2] | step[3]).sum())
    assert ends > 10
    assert_same(ours.reset(seed=[1, None, 3, 4, 5], options={"count": 3})[1]["count"], np.full(5, 3))
    ours.close()


def test_disabled_autoreset_waits_for_a_masked_reset() -> None:
    ours = make_toys(autoreset_mode="Disabled")
    theirs = SyncVectorEnv([Toy] * 5, autoreset_mode=AutoresetMode.DISABLED)
    ours.reset(seed=2), theirs.reset(seed=2)
    ended = np.zeros(5, bool)
    while not ended.any():
        step = ours.step(np.zeros((5, 2), np.float32))
        assert_same(step, theirs.step(np.zeros((5, 2), np.float32)))
        ended = step[2] | step[3]
    with pytest.raises(gym.error.ResetNeeded, match=str(np.flatnonzero(ended).tolist()[0])):
        ours.step(np.zeros((5, 2), np.float32))
    options = {"reset_mask": ended}
    assert_same(ours.reset(options=options), theirs.reset(options=dict(options)))
    assert "reset_mask" in options
    ours.step(np.zeros((5, 2), np.float32))
    ours.close()


@pytest.mark.parametrize("caller_steps", [False, True])
def test_climbing_is_the_same_in_workers(caller_steps: bool) -> None:
    """Through `gym.make_vec`, with the default start method and a time limit that strikes."""
    kwargs: dict[str, Any] = {"num_envs": 3, "direction": "both", "max_episode_steps": 6}
    mode = "vector_entry_point"
    ours = gym.make_vec(PLAIN, vectorization_mode=mode, workers=2, caller_steps=caller_steps, **kwargs)
    theirs = gym.make_vec(PLAIN, vectorization_mode="sync", **kwargs)
    rng = np.random.default_rng(1)
    assert_same(ours.reset(seed=7), theirs.reset(seed=7))
    truncations = 0
    for _ in range(14):
        actions = rng.uniform(-0.3, 0.3, (3, 16)).astype(np.float32)
        step = ours.step(actions)
        assert_same(step, theirs.step(actions))
        truncations += int(step[3].sum())
    assert truncations >= 6
    ours.close(), theirs.close()


def test_ids_declare_their_vector_form_and_time_limit() -> None:
    assert gym.spec(PLAIN).vector_entry_point and gym.spec(RGBD).vector_entry_point
    env = gym.make_vec(PLAIN, num_envs=2, workers=1, context="fork")
    assert isinstance(env, WorkerVectorEnv)
    assert env.get_attr("spec")[1].max_episode_steps == stair_env.MAX_EPISODE_STEPS
    assert type(env.metadata["autoreset_mode"]) is AutoresetMode
    env.close()


def test_frames_come_through_shared_memory() -> None:
    camera = {"mode": "640x480", "renderer": "tiny", "depth_error": "ideal"}
    single = gym.make(RGBD, camera=camera, disable_env_checker=True)
    vector = make_worker_vec(RGBD, 1, camera=camera, context="fork")
    observation, _ = vector.reset(seed=1)
    assert observation["rgb"].shape == (1, 480, 640, 3) and observation["rgb"].std() > 0
    assert_same({key: value[0] for key, value in observation.items()}, single.reset(seed=1)[0])
    vector.close(), single.close()


@pytest.mark.parametrize("context", ["forkserver", "spawn"])
def test_start_methods_and_light_workers(context: str) -> None:
    env = make_toys(3, context=context)
    assert env.get_attr("has_torch") == (False,) * 3
    assert not np.array_equal(env.reset(seed=0)[0]["state"][0], env.reset(seed=1)[0]["state"][0])
    env.close()


@pytest.mark.parametrize(("harm", "cause"), [(KILL, "SIGKILL"), (EXIT, "exit code 7")])
def test_a_dead_worker_is_named_within_seconds(toys: WorkerVectorEnv, harm: float, cause: str) -> None:
    actions = np.zeros((5, 2), np.float32)
    actions[3, 0] = harm
    before = time.monotonic()
    with pytest.raises(WorkerError, match=rf"worker 1 \(environments 3-4.*{cause}"):
        toys.step(actions)
    assert time.monotonic() - before < 10
    with pytest.raises(RuntimeError, match=cause):  # and again, instead of a hang
        toys.reset()


def test_a_worker_killed_between_steps_is_named(toys: WorkerVectorEnv) -> None:
    os.kill(toys.pool.pids[0], signal.SIGKILL)
    with pytest.raises(WorkerError, match=r"worker 0 \(environments 0-2.*SIGKILL"):
        toys.step(np.zeros((5, 2), np.float32))


def test_a_silent_worker_is_given_up() -> None:
    env = make_toys(2, timeout_s=0.5)
    env.reset(seed=0)
    with pytest.raises(WorkerError, match=r"worker 1 \(environment 1.*not answered for 0.5 s"):
        env.step(np.array([[0, 0], [SLEEP, 0]], np.float32))
    env.close()


def test_an_exception_comes_back_with_its_traceback(toys: WorkerVectorEnv) -> None:
    actions = np.zeros((5, 2), np.float32)
    actions[4, 0] = RAISE
    with pytest.raises(WorkerError, match=r"(?s)environment 4 of worker 1.*in step.*ValueError: the stairs are gone"):
        toys.step(actions)
    toys.reset(seed=0)  # the workers live on
    toys.step(np.zeros((5, 2), np.float32))


def test_an_environment_that_cannot_be_built_is_named() -> None:
    built: list[int] = []

    def second_fails() -> Toy:
        built.append(1)
        if len(built) > 1:
            raise OSError("no such robot")
        return Toy()

    with pytest.raises(WorkerError, match=r"(?s)environment 0 of worker 0.*OSError: no such robot"):
        WorkerVectorEnv([second_fails], context="fork")


def test_a_caller_that_steps_too_loses_nobody_and_nothing() -> None:
    """Failures in its own share and in a worker's, lookups across both, and the end of its environments."""
    closed: list[str] = []

    class Closing(Toy):
        def close(self) -> None:
            closed.append(self.label)

    env = WorkerVectorEnv([Toy, Toy, Closing], workers=2, caller_steps=True, context="fork")
    closed.clear()  # of the environment that told its spaces
    env.reset(seed=0)
    own, other = np.zeros((2, 3, 2), np.float32)
    own[2, 0], other[1, 0] = RAISE, RAISE
    for actions, match in ((own, "environment 2 of worker 1"), (other, "environment 1 of worker 0")):
        with pytest.raises(WorkerError, match=f"(?s){match}.*ValueError: the stairs are gone"):
            env.step(actions)
    env.reset(seed=0)
    env.set_attr("label", ["a", "b", "c"])
    assert env.get_attr("label") == ("a", "b", "c") and env.call("double", 2) == (4, 4, 4)
    with pytest.raises(AttributeError, match="no_such_thing"):
        env.get_attr("no_such_thing")
    other[1, 0] = KILL
    with pytest.raises(WorkerError, match=r"worker 0 \(environments 0-1.*SIGKILL"):
        env.step(other)
    with pytest.raises(WorkerError, match="SIGKILL"):
        env.step(own)
    assert closed == ["c"]


def test_a_caller_alone_needs_no_process() -> None:
    env = make_toys(3, workers=1, caller_steps=True)
    env.reset(seed=0)
    assert env.pool.pids == [] and env.step(np.full((3, 2), 0.5, np.float32))[1].tolist() == [1.0, 1.0, 1.0]
    env.close()


def test_attributes_and_methods_reach_every_environment(toys: WorkerVectorEnv) -> None:
    assert toys.call("double", 4) == (8,) * 5
    toys.set_attr("label", ["a", "b", "c", "d", "e"])
    assert toys.get_attr("label") == ("a", "b", "c", "d", "e")
    with pytest.raises(AttributeError, match="no_such_thing"):
        toys.get_attr("no_such_thing")
    with pytest.raises(WorkerError, match="pickle"):
        toys.call("lock")
    assert toys.call("double", 1) == (2,) * 5  # nothing is out of step after that


def test_a_copy_stays_and_a_view_moves_on() -> None:
    for copy in (True, False):
        env = make_toys(2, copy=copy)
        first, _ = env.reset(seed=0)
        kept = first["state"].copy()
        env.step(np.zeros((2, 2), np.float32))
        assert np.array_equal(first["state"], kept) == copy
        env.close()


def test_closing_ends_every_worker_and_leaves_nothing() -> None:
    shared = Path("/dev/shm")
    before = set(shared.iterdir()) if shared.exists() else set()
    env = make_toys()
    env.reset(seed=0)
    env.step_async(np.zeros((5, 2), np.float32))  # closing may come in the middle of a step
    processes = env.pool.pids
    env.close()
    env.close()
    assert not any(Path(f"/proc/{pid}").exists() for pid in processes)
    assert not shared.exists() or {p for p in set(shared.iterdir()) - before if "pym-" in p.name} == set()
    with pytest.raises(WorkerError, match="closed"):
        env.step(np.zeros((5, 2), np.float32))


def test_workers_end_with_the_object() -> None:
    env = make_toys()
    processes = env.pool.pids
    del env
    assert not any(Path(f"/proc/{pid}").exists() for pid in processes)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"num_envs": 0}, "num_envs=0"),
        ({"robot": "cat"}, "robot='cat'.*aliengo"),
        ({"context": "thread"}, "context='thread'.*fork"),
        ({"autoreset_mode": "never"}, "autoreset_mode='never'.*NextStep"),
        ({"workers": 9}, "workers=9"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        gym.make_vec(PLAIN, **{"num_envs": 2, **arguments})


def test_wrong_calls_are_named(toys: WorkerVectorEnv) -> None:
    for call, match in (
        (partial(toys.step, np.zeros((4, 2))), r"\(4, 2\).*\(5, 2\)"),
        (partial(toys.reset, seed=[1, 2]), "num_envs=5"),
        (partial(toys.reset, options={"reset_mask": np.ones(4, bool)}), "reset_mask"),
        (partial(toys.step, np.full((5, 2), np.nan)), r"actions holds nan at index \(0, 0\)"),
        (partial(toys.call, "reset"), "reset"),
        (partial(toys.set_attr, "label", ["a"]), "num_envs=5"),
    ):
        with pytest.raises(ValueError, match=match):
            call()


def test_a_mask_of_another_kind_is_a_type_error(toys: WorkerVectorEnv) -> None:
    for mask in ([True] * 5, np.ones(5, int)):
        with pytest.raises(TypeError, match="reset_mask"):
            toys.reset(options={"reset_mask": mask})


def test_gymnasiums_own_exceptions_say_what_was_called_out_of_turn(toys: WorkerVectorEnv) -> None:
    with pytest.raises(gym.error.NoAsyncCallError):
        toys.step_wait()
    toys.reset(seed=0)
    actions = np.zeros(toys.action_space.shape, np.float32)
    toys.step_async(actions)
    for call in (partial(toys.step_async, actions), toys.reset, partial(toys.call, "label")):
        with pytest.raises(gym.error.AlreadyPendingCallError):
            call()
    toys.step_wait()
    toys.close()
    calls = (toys.reset, partial(toys.step, actions), toys.step_wait, partial(toys.call, "label"), toys.render)
    for call in (*calls, partial(toys.set_attr, "label", 1)):
        with pytest.raises(gym.error.ClosedEnvironmentError):
            call()


def test_a_vector_tells_its_mode_and_its_seeds(toys: WorkerVectorEnv) -> None:
    toys.reset(seed=np.int64(7))
    assert toys.autoreset_mode is toys.metadata["autoreset_mode"]
    assert toys.np_random_seed == (7, 8, 9, 10, 11)
    assert len({rng.bit_generator.state["state"]["state"] for rng in toys.np_random}) == 5


def test_what_the_caller_did_wrong_keeps_its_name_across_processes() -> None:
    vector = gym.make_vec("stair_env/StairClimb-v0", num_envs=2, workers=2, caller_steps=False)
    try:
        with pytest.raises(gym.error.ResetNeeded, match="environment 0 of worker 0"):
            vector.step(np.zeros((2, 16), np.float32))
        for options, match in (({"there": 1}, "option='there'"), ({"x": math.nan}, "option x=nan")):
            with pytest.raises(SpecError, match=rf"environment 0 of worker 0.*{match}"):
                vector.reset(seed=0, options=options)
        vector.reset(seed=0)  # and nothing is broken by it
    finally:
        vector.close()
