"""What runs in a worker process: it owns several environments and steps them one after the other.

Actions, observations, rewards and flags go through shared arrays; the pipe carries one short request and one answer per
vector step, the answer with the infos of all the worker's environments.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import gymnasium as gym
import numpy as np

from stair_env.vectorized.errors import CALLERS_FAULTS
from stair_env.vectorized.shared_arrays import SharedArrays
from stair_env.vectorized.wait import Watch

EnvFactory = Callable[[], gym.Env]
Request = tuple[int, str, tuple[Any, ...]]  # number, command, arguments
OBSERVATION = "observation/"  # prefix of the shared arrays that hold the observation, one per key
STAIRS, STAIRS_GIVEN = "stairs", "stairs given"  # blocks for the gaits, and whether there are new ones
AWAKE_S = 5e-4  # how long one who waits for the other side of a pipe stays awake: a parent's work between two steps
ORPHAN_CHECK_S = 2.0  # how often an idle worker looks whether its parent still lives
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class WorkerTask:
    """What a worker is started with.

    Args:
        factories: one per environment, called in the worker.
        first: index of the worker's first environment within the vector.
        next_step: an environment whose episode ended begins the next one in place of its next step.
        same_step: it begins the next one within the step that ended the last.
    """

    factories: Sequence[EnvFactory]
    first: int
    next_step: bool
    same_step: bool


@dataclass(frozen=True)
class StepInfo:
    """What one environment says beside the shared arrays.

    Attributes:
        info: of the last call, which is that of the new episode's reset if one began.
        final_observation, final_info: of the episode that ended within this step (same_step), else None.
    """

    info: dict[str, Any]
    final_observation: Any = None
    final_info: dict[str, Any] | None = None


@dataclass(frozen=True)
class Failure:
    """An exception in an environment.

    Attributes:
        index: of the environment within the vector.
        text: the traceback, or for a fault of the caller's the message.
        is_attribute_error: whether it was an AttributeError, which callers may expect.
        fault: index in `CALLERS_FAULTS`, None for a fault of the environment.
    """

    index: int
    text: str
    is_attribute_error: bool = False
    fault: int | None = None


def failure_of(error: Exception, index: int) -> Failure:
    """What is told of an exception that environment `index` raised."""
    for number, (kind, _) in enumerate(CALLERS_FAULTS):
        if isinstance(error, kind):
            return Failure(index, str(error), fault=number)
    return Failure(index, traceback.format_exc(), isinstance(error, AttributeError))


class Worker:
    """The environments of one share, stepped in the process that holds this, and what can be asked of them.

    Args:
        task: what to build.
        arrays: shared with the parent, whole batches.
    """

    def __init__(self, task: WorkerTask, arrays: dict[str, np.ndarray]) -> None:
        self._task, self._arrays = task, arrays
        self.current = task.first  # environment at work, for error messages
        self._envs: list[gym.Env] = []
        self._ended = [False] * len(task.factories)
        self._commands: dict[str, Callable[..., Any]] = {
            "build": self.build,
            "step": self.step,
            "reset": self.reset,
            "call": self.call,
            "get": self.get_attribute,
            "set": self.set_attribute,
            "classes": self.wrapper_classes,
        }

    def build(self) -> None:
        """Make the environments."""
        for offset, factory in enumerate(self._task.factories):
            self.current = self._task.first + offset
            self._envs.append(factory())

    def attempt(self, command: str, arguments: tuple[Any, ...]) -> Any:
        """The result of a request, or the `Failure` that it ended in."""
        try:
            return self._commands[command](*arguments)
        except Exception as error:
            return failure_of(error, self.current)

    def step(self) -> list[StepInfo]:
        """Step every environment with its row of the shared actions."""
        return [self._step_one(offset) for offset in range(len(self._envs))]

    def reset(self, requests: Sequence[tuple[int, int | None, dict[str, Any] | None]]) -> list[dict[str, Any]]:
        """Begin episodes.

        Args:
            requests: (index within the vector, seed, options) each.

        Returns:
            The infos, in the order of the requests.
        """
        infos = []
        for index, seed, options in requests:
            env = self._environment(index)
            observation, info = env.reset(seed=seed, options=options)
            self._put(observation, 0.0, False, False)
            infos.append(info)
        return infos

    def call(self, indices: Sequence[int], name: str, args: tuple[Any, ...], kwargs: dict[str, Any]) -> list[Any]:
        """Call a method of environments, or read an attribute that is none."""
        results = []
        for index in indices:
            attribute = self._environment(index).get_wrapper_attr(name)
            results.append(attribute(*args, **kwargs) if callable(attribute) else attribute)
        return results

    def get_attribute(self, indices: Sequence[int], name: str) -> list[Any]:
        """Read an attribute of environments; a method is not called."""
        return [self._environment(index).get_wrapper_attr(name) for index in indices]

    def set_attribute(self, indices: Sequence[int], name: str, values: Sequence[Any]) -> None:
        """Set an attribute where it is found among wrappers and environment."""
        for index, value in zip(indices, values, strict=True):
            self._environment(index).set_wrapper_attr(name, value)

    def wrapper_classes(self, indices: Sequence[int]) -> list[list[tuple[str, str]]]:
        """(module, name) of every class that each environment or a wrapper around it is an instance of."""
        return [
            [(c.__module__, c.__qualname__) for layer in _layers(self._environment(i)) for c in type(layer).__mro__]
            for i in indices
        ]

    def close(self) -> None:
        """Close the environments."""
        for env in self._envs:
            env.close()

    def _environment(self, index: int) -> gym.Env:
        self.current = index
        return self._envs[index - self._task.first]

    def _step_one(self, offset: int) -> StepInfo:
        env = self._environment(self._task.first + offset)
        given, self._arrays[STAIRS_GIVEN][self.current] = bool(self._arrays[STAIRS_GIVEN][self.current]), False
        if self._task.next_step and self._ended[offset]:
            observation, info = env.reset()
            self._put(observation, 0.0, False, False)
            return StepInfo(info)
        if given:
            unwrapped: Any = env.unwrapped
            unwrapped.provide_stair(self._arrays[STAIRS][self.current])
        action = self._arrays["action"][self.current].copy()
        observation, reward, terminated, truncated, info = env.step(action)
        if not (self._task.same_step and (terminated or truncated)):
            self._put(observation, float(reward), terminated, truncated)
            return StepInfo(info)
        first_observation, first_info = env.reset()
        self._put(first_observation, float(reward), terminated, truncated)
        return StepInfo(first_info, observation, info)

    def _put(self, observation: Any, reward: float, terminated: bool, truncated: bool) -> None:
        """Write the row of the environment at work."""
        arrays, row = self._arrays, self.current
        for key, value in observation.items():
            arrays[OBSERVATION + key][row] = value
        arrays["reward"][row] = reward
        arrays["terminated"][row], arrays["truncated"][row] = terminated, truncated
        self._ended[row - self._task.first] = terminated or truncated


def _layers(env: gym.Env) -> list[gym.Env]:
    layers = [env]
    while isinstance(layers[-1], gym.Wrapper):
        layers.append(layers[-1].env)
    return layers


def run_worker(pickled_task: Callable[[], WorkerTask], shared: SharedArrays, connection: Connection) -> None:
    """Serve requests until told to stop or left alone: the worker's main function.

    Args:
        pickled_task: returns the task.
        shared: arrays of the whole vector.
        connection: to the parent.
    """
    _settle_in()
    parent = os.getppid()
    worker = Worker(pickled_task(), shared.views())
    watch = Watch()
    watch.add(connection)
    try:
        _answer(connection, worker, (0, "build", ()))
        while request := _next_request(connection, watch, parent):
            _answer(connection, worker, request)
    finally:
        with contextlib.suppress(Exception):
            worker.close()


def _settle_in() -> None:
    """One thread a worker, for there are as many workers as cores; Ctrl-C is the parent's to handle."""
    for name in THREAD_VARIABLES:
        os.environ.setdefault(name, "1")
    if "numba" in sys.modules:  # inherited through a fork: too late for the variable
        sys.modules["numba"].set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _next_request(connection: Connection, watch: Watch, parent: int) -> Request | None:
    """The next request; None when there will be none."""
    try:
        while not watch.ready(ORPHAN_CHECK_S, AWAKE_S):
            if os.getppid() != parent:  # under fork, siblings hold the pipe open when the parent is gone
                return None
        request: Request | None = connection.recv()
    except (EOFError, OSError):
        return None
    return request


def _answer(connection: Connection, worker: Worker, request: Request) -> None:
    """Send the result of a request, or how it failed (also if the result cannot be pickled)."""
    number, command, arguments = request
    result = worker.attempt(command, arguments)
    try:
        message = _pickle((number, result))  # `send` is slow at small things
    except Exception:
        message = pickle.dumps((number, Failure(worker.current, traceback.format_exc())))
    with contextlib.suppress(BrokenPipeError):
        connection.send_bytes(message)


def _pickle(answer: tuple[int, Any]) -> bytes:
    """Pickle, where need be with cloudpickle, which is slower but also takes functions and classes of a script."""
    try:
        return pickle.dumps(answer, pickle.HIGHEST_PROTOCOL)
    except Exception:
        import cloudpickle

        message: bytes = cloudpickle.dumps(answer)
        return message
