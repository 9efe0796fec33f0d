"""Environments in worker processes: few workers with several environments each, and no silence when one dies.

One exchange of messages per environment and step costs more than the physics, so there are no more workers than cores;
each steps its share of the environments in turn (`stair_env.vectorized.worker`).
"""

from __future__ import annotations

import itertools
import os
import pickle
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
from typing import Any, NoReturn

import cloudpickle
import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import CloudpickleWrapper

from stair_env.common.validation import check_choice, read_action
from stair_env.observation import STAIR_FIELDS
from stair_env.vectorized.errors import (
    CALLERS_FAULTS,
    EnvironmentsClosedError,
    NoStepError,
    StepPendingError,
    WorkerError,
)
from stair_env.vectorized.lifetime import end_processes, exit_cause, start_context
from stair_env.vectorized.shared_arrays import ArrayLayout, SharedArrays
from stair_env.vectorized.wait import Watch
from stair_env.vectorized.worker import (
    AWAKE_S,
    OBSERVATION,
    STAIRS,
    STAIRS_GIVEN,
    EnvFactory,
    Failure,
    StepInfo,
    Worker,
    WorkerTask,
    run_worker,
)

DEATH_CHECK_S = 1.0  # upper bound on how late a timeout is noticed
BUILDING = "construction"
LOOKUPS = ("call()", "get()")  # an AttributeError in these is the asker's, who may expect it
EXIT_GRACE_S = 2.0  # for the exit code of a process whose pipe broke


class WorkerPool:
    """Runs environments in processes.

    Args:
        factories: one per environment; anything that cloudpickle can send.
        observation_space: of one environment, a Dict of Boxes.
        action_space: of one environment.
        autoreset: "next_step", "same_step" or "disabled" (the caller resets).
        workers: number of processes that step; None takes the number of cores, at most one per environment.
        caller_steps: whether the calling process is one of them and steps the last share itself, while it would else
            wait. An environment that takes its process down takes the caller down too.
        context: "fork", "forkserver" or "spawn"; None takes "forkserver" where there is one, else "spawn".
        timeout_s: how long a worker may take for one request.

    Raises:
        ValueError: an argument is wrong.
        WorkerError: a worker could not be started.
    """

    def __init__(
        self,
        factories: Sequence[EnvFactory],
        observation_space: spaces.Dict,
        action_space: spaces.Box,
        *,
        autoreset: str,
        workers: int | None = None,
        caller_steps: bool = False,
        context: str | None = None,
        timeout_s: float = 300.0,
    ) -> None:
        check_choice("autoreset", autoreset, ("next_step", "same_step", "disabled"))
        self.num_envs = len(factories)
        self._timeout_s = timeout_s
        self._broken: str | None = None
        self._closed = self._pending = False
        self._number = 0  # of the last request; an answer to an older one (Ctrl-C left it unread) is dropped
        ctx = start_context(context)
        arrays = SharedArrays(_layout(self.num_envs, observation_space, action_space), ctx)
        views = arrays.views()
        self.observation = {key: views[OBSERVATION + key] for key in observation_space.spaces}
        self.actions, self.rewards = views["action"], views["reward"]
        self._stairs, self._stairs_given = views[STAIRS], views[STAIRS_GIVEN]
        self.terminated, self.truncated = views["terminated"], views["truncated"]
        self._processes: list[BaseProcess] = []
        self._connections: list[Connection] = []
        self._own: list[Worker] = []  # at most one: of the share that this process steps
        self._own_request: tuple[str, tuple[Any, ...]] | None = None
        self._watch = Watch()
        self.shares = _shares(self.num_envs, _worker_count(workers, self.num_envs))
        # The finalizer knows the lists and not the pool, so that a pool nobody holds any more ends its processes.
        self._finalizer = weakref.finalize(self, _end, os.getpid(), self._processes, self._connections, self._own)
        try:
            for share in self.shares:
                task = WorkerTask(
                    [factories[i] for i in share], share.start, autoreset == "next_step", autoreset == "same_step"
                )
                if caller_steps and share is self.shares[-1]:
                    self._own.append(Worker(task, views))
                    self._own_request = ("build", ())
                else:
                    self._start(ctx, task, arrays)
            self._collect(range(len(self.shares)), BUILDING)
        except BaseException:
            self.close()
            raise

    # ------------------------------------------------------------------ what can be asked

    def begin_step(self, actions: np.ndarray) -> None:
        """Have every environment make a step.

        Args:
            actions: (num_envs, action size).

        Raises:
            ValueError: wrong shape, or not finite.
            WorkerError: the pool is closed or broken, or a step is under way (`stair_env.vectorized.errors`).
        """
        self._check_ready()
        self.actions[:] = read_action(actions, self.actions.shape, "actions")
        self._number += 1
        message = pickle.dumps((self._number, "step", ()))
        for worker in range(len(self._processes)):
            self._send(worker, message)
        self._own_request = ("step", ())
        self._pending = True

    def provide_stairs(self, blocks: np.ndarray) -> None:
        """Give each environment the stair block that its gait reads at the next step, if that is no reset.

        Args:
            blocks: (num_envs, 8), see `stair_env.observation.STAIR_FIELDS`.

        Raises:
            ValueError: wrong shape.
            WorkerError: the pool is closed or broken, or a step is under way.
        """
        if np.shape(blocks) != self._stairs.shape:
            raise ValueError(f"blocks have shape {np.shape(blocks)}, must be {self._stairs.shape}")
        self._check_ready()
        self._stairs[:] = blocks
        self._stairs_given[:] = True

    def finish_step(self) -> list[StepInfo]:
        """Wait for the step; the shared arrays hold its results until the next.

        Raises:
            WorkerError: see the class.
        """
        if self._broken:
            self._refuse()
        if not self._pending:
            raise NoStepError("no step is under way: begin one first")
        self._pending = False
        return self._gather(range(len(self.shares)), "step()")

    def reset(self, requests: Mapping[int, tuple[int | None, dict[str, Any] | None]]) -> dict[int, dict[str, Any]]:
        """Begin episodes.

        Args:
            requests: (seed, options) by index of the environment.

        Returns:
            The infos by index.
        """
        return self._ask(list(requests), "reset", lambda own: ([(i, *requests[i]) for i in own],))

    def call(self, indices: Sequence[int], name: str, *args: Any, **kwargs: Any) -> list[Any]:
        """Call a method of environments, or read an attribute, through their wrappers.

        Raises:
            AttributeError: there is no such attribute.
        """
        results = self._ask(indices, "call", lambda own: (own, name, args, kwargs))
        return [results[i] for i in indices]

    def get_attribute(self, indices: Sequence[int], name: str) -> list[Any]:
        """Read an attribute of environments; a method is not called.

        Raises:
            AttributeError: there is no such attribute.
        """
        results = self._ask(indices, "get", lambda own: (own, name))
        return [results[i] for i in indices]

    def set_attribute(self, indices: Sequence[int], name: str, values: Sequence[Any]) -> None:
        """Set an attribute of environments, one value each."""
        chosen = dict(zip(indices, values, strict=True))
        self._ask(indices, "set", lambda own: (own, name, [chosen[i] for i in own]))

    def wrapper_classes(self, indices: Sequence[int]) -> list[list[tuple[str, str]]]:
        """(module, name) of the classes of each environment and its wrappers, base classes included."""
        results = self._ask(indices, "classes", lambda own: (own,))
        return [results[i] for i in indices]

    def close(self) -> None:
        """End the workers; safe to call twice."""
        self._closed = self._broken is None or self._closed
        self._broken = self._broken or "the environments are closed"
        self._finalizer()

    @property
    def pids(self) -> list[int]:
        """Process ids of the workers, the calling process not among them."""
        return [process.pid or 0 for process in self._processes]

    # ------------------------------------------------------------------ exchange

    def _start(self, ctx: BaseContext, task: WorkerTask, arrays: SharedArrays) -> None:
        ours, theirs = ctx.Pipe()
        name = f"stair_env-worker-{len(self._processes)}"
        arguments = (CloudpickleWrapper(_Returns(task)), arrays, theirs)
        process = ctx.Process(target=run_worker, args=arguments, name=name, daemon=True)  # type: ignore[attr-defined]
        process.start()
        theirs.close()
        self._processes.append(process)
        self._connections.append(ours)
        self._watch.add(ours)
        self._watch.add(process.sentinel)

    def _ask(
        self, indices: Sequence[int], command: str, arguments: Callable[[list[int]], tuple[Any, ...]]
    ) -> dict[int, Any]:
        """Send a request to the workers of these environments; results by index (None where there are none)."""
        self._check_ready()
        own = {worker: [i for i in indices if i in share] for worker, share in enumerate(self.shares)}
        asked = [worker for worker, chosen in own.items() if chosen]
        self._number += 1
        for worker in asked:
            if worker < len(self._processes):
                self._send(worker, cloudpickle.dumps((self._number, command, arguments(own[worker]))))
            else:
                self._own_request = (command, arguments(own[worker]))
        order = [i for worker in asked for i in own[worker]]
        results = self._gather(asked, f"{command}()")
        return dict(zip(order, results, strict=False))

    def _send(self, worker: int, message: bytes) -> None:
        """Send a pickled request to a process."""
        try:
            self._connections[worker].send_bytes(message)
        except (BrokenPipeError, ConnectionResetError):
            self._report_death(worker, "idleness")

    def _gather(self, workers: Sequence[int], doing: str) -> list[Any]:
        answers = self._collect(workers, doing)
        return [result for worker in workers for result in answers[worker] or ()]

    def _collect(self, workers: Sequence[int], doing: str) -> dict[int, Any]:
        """One answer from each worker; watches that none dies or falls silent meanwhile."""
        answers: dict[int, Any] = {}
        deadline = time.monotonic() + self._timeout_s
        if self._own and len(self._processes) in workers:  # the others are at work by now
            assert self._own_request is not None
            answers[len(self._processes)] = self._own[0].attempt(*self._own_request)
        while len(answers) < len(workers):
            # While nobody has answered, the workers need the cores more than whoever waits for them.
            ready = self._watch.ready(DEATH_CHECK_S, AWAKE_S if answers else 0.0)
            if not ready and time.monotonic() > deadline:
                late = next(worker for worker in workers if worker not in answers)
                self._break(f"{self._name(late)} has not answered for {self._timeout_s:g} s ({doing})")
            for worker, (connection, process) in enumerate(zip(self._connections, self._processes)):
                if connection in ready:
                    number, answer = self._receive(worker, doing)
                    if number == self._number:
                        answers[worker] = answer
                elif process.sentinel in ready and worker not in answers:
                    self._report_death(worker, doing)
        self._raise_failure(answers, doing)
        return answers

    def _receive(self, worker: int, doing: str) -> tuple[int, Any]:
        try:
            answer: tuple[int, Any] = self._connections[worker].recv()
        except (EOFError, OSError):
            self._report_death(worker, doing)
        return answer

    def _raise_failure(self, answers: Mapping[int, Any], doing: str) -> None:
        for worker, answer in sorted(answers.items()):
            if isinstance(answer, Failure):
                text = f"environment {answer.index} of worker {worker} raised in {doing}:\n{answer.text}"
                if answer.fault is not None:
                    raise CALLERS_FAULTS[answer.fault][1](text.replace("\n", " ", 1))
                raise AttributeError(text) if answer.is_attribute_error and doing in LOOKUPS else WorkerError(text)

    def _report_death(self, worker: int, doing: str) -> NoReturn:
        process = self._processes[worker]
        process.join(EXIT_GRACE_S)
        hint = ""
        if doing == BUILDING:
            hint = '; with spawn and forkserver a script needs `if __name__ == "__main__":` around what it starts'
        self._break(f"{self._name(worker)} died in {doing}: {exit_cause(process.exitcode)}{hint}")

    def _break(self, message: str) -> NoReturn:
        """Give the pool up: the other workers' state is worth nothing without this one."""
        self._broken = message
        for process in self._processes:
            process.kill()
        self._finalizer()
        raise WorkerError(message)

    def _check_ready(self) -> None:
        if self._broken:
            self._refuse()
        if self._pending:
            raise StepPendingError("a step is under way: finish it first")

    def _refuse(self) -> NoReturn:
        if self._closed:
            raise EnvironmentsClosedError("the environments are closed")
        raise WorkerError(self._broken)

    def _name(self, worker: int) -> str:
        share = self.shares[worker]
        which = f"environment {share[0]}" if len(share) == 1 else f"environments {share[0]}-{share[-1]}"
        return f"worker {worker} ({which}, process {self._processes[worker].pid})"


class _Returns:
    """A function that returns one value, for cloudpickle's wrapper."""

    def __init__(self, value: Any) -> None:
        self._value = value

    def __call__(self) -> Any:
        return self._value


def _worker_count(workers: int | None, num_envs: int) -> int:
    if num_envs < 1:
        raise ValueError(f"num_envs={num_envs!r} must be >= 1")
    if workers is None:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        return min(cores, num_envs)
    if not 1 <= workers <= num_envs:
        raise ValueError(f"workers={workers!r} must be within 1..{num_envs} (num_envs)")
    return workers


def _shares(num_envs: int, workers: int) -> list[range]:
    """Environments in order, dealt as evenly as can be, the larger shares first."""
    least, more = divmod(num_envs, workers)
    ends = itertools.accumulate(least + (worker < more) for worker in range(workers))
    return [range(low, high) for low, high in itertools.pairwise([0, *ends])]


def _layout(num_envs: int, observation_space: spaces.Dict, action_space: spaces.Box) -> ArrayLayout:
    layout: dict[str, tuple[tuple[int, ...], np.dtype[Any]]] = {
        "action": ((num_envs, *action_space.shape), np.dtype(action_space.dtype)),
        "reward": ((num_envs,), np.dtype(np.float64)),
        "terminated": ((num_envs,), np.dtype(bool)),
        "truncated": ((num_envs,), np.dtype(bool)),
        STAIRS: ((num_envs, len(STAIR_FIELDS)), np.dtype(np.float64)),
        STAIRS_GIVEN: ((num_envs,), np.dtype(bool)),
    }
    for key, space in observation_space.spaces.items():
        if not isinstance(space, spaces.Box):
            raise ValueError(f"observation {key!r} is {space}, must be a Box")
        layout[OBSERVATION + key] = ((num_envs, *space.shape), np.dtype(space.dtype))
    return layout


def _end(owner: int, processes: list[BaseProcess], connections: list[Connection], own: list[Worker]) -> None:
    """End the workers and close the caller's environments."""
    end_processes(owner, processes, connections)
    if os.getpid() == owner:
        for worker in own:
            worker.close()
