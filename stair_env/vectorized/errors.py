"""Errors of environments in worker processes: each a WorkerError, and also what Gymnasium calls it."""

from __future__ import annotations

import gymnasium as gym

from stair_env.common.validation import SpecError


class WorkerError(RuntimeError):
    """A worker process died, fell silent, or one of its environments raised."""


class EnvironmentsClosedError(WorkerError, gym.error.ClosedEnvironmentError):
    """The vector of environments was closed."""


class StepPendingError(WorkerError, gym.error.AlreadyPendingCallError):
    """A step is under way, and must be finished before anything else is asked."""

    def __init__(self, message: str, name: str = "step") -> None:
        gym.error.AlreadyPendingCallError.__init__(self, message, name)


class NoStepError(WorkerError, gym.error.NoAsyncCallError):
    """No step is under way that could be finished."""

    def __init__(self, message: str, name: str = "step") -> None:
        gym.error.NoAsyncCallError.__init__(self, message, name)


class WorkerSpecError(WorkerError, SpecError):
    """An environment in a worker refused an argument."""


class WorkerResetNeededError(WorkerError, gym.error.ResetNeeded):
    """An environment in a worker must be reset first."""


# What the caller did wrong, told without a traceback; anything else is a fault of the environment.
CALLERS_FAULTS: tuple[tuple[type[Exception], type[WorkerError]], ...] = (
    (SpecError, WorkerSpecError),
    (gym.error.ResetNeeded, WorkerResetNeededError),
)
