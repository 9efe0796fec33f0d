"""When an episode ends: functions of a control step by name, judged by the truth."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stair_env.common.validation import SpecError, check_choice
from stair_env.task.step_state import FAILURES, StepState

__all__ = ["DEFAULT_TERMINATIONS", "FAILURES", "Terminations", "read_terminations"]

FALL_COSINE = 0.45  # trunk tilted more than 63° from upright
UPRIGHT_COSINE = 0.8  # a robot that has arrived is tilted less than 37°
FALL_HEIGHT_SHARE = 0.4  # of the standing height above the ground below
WALKED_AWAY_M = 1.5  # behind the start
LANDED_M = 0.15  # how far a foot that stands on the landing may be above or below it

TerminationFunction = Callable[[StepState], bool]


def fall(state: StepState) -> bool:
    """The trunk is tilted too far or too low, or the physics broke."""
    x, y, z = state.after.position.tolist()
    if not math.isfinite(x + y + z):
        return True
    mean_under_feet = sum(state.ground_under_feet) / 4
    low_trunk = FALL_HEIGHT_SHARE * state.episode.robot.stand_height
    up = float(state.after.rotation[2, 2])
    return up < FALL_COSINE or z - min(state.ground_under_base, mean_under_feet) < low_trunk


def left_flight(state: StepState) -> bool:
    """The base is beside the stairs."""
    x, y, _ = state.after.position.tolist()
    return abs(y) > state.episode.stairs.flight_width / 2 and 0.0 < x < state.episode.profile.plain[0][-1]


def walked_away(state: StepState) -> bool:
    """The base is far behind its start."""
    return float(state.after.position[0]) < state.episode.start_x - WALKED_AWAY_M


def success(state: StepState) -> bool:
    """Both rear feet are on the landing, and the trunk is upright."""
    edges, levels = state.episode.profile.plain
    landed = all(x > edges[-1] and abs(z - levels[-1]) < LANDED_M for x, _, z in state.feet[2:].tolist())
    return landed and float(state.after.rotation[2, 2]) > UPRIGHT_COSINE


DEFAULT_TERMINATIONS: dict[str, TerminationFunction] = {
    fn.__name__: fn for fn in (fall, left_flight, walked_away, success)
}


class Terminations:
    """The ways in which an episode may end, asked in order.

    Args:
        functions: by name.
    """

    def __init__(self, functions: Mapping[str, TerminationFunction]) -> None:
        self.functions = dict(functions)
        self._asked = list(functions.items())

    def reason(self, state: StepState) -> str:
        """Return the name of the first that says so, empty while the episode goes on."""
        for name, fn in self._asked:
            if fn(state):
                return name
        return ""


def read_terminations(terminations: Mapping[str, Any] | None = None) -> Terminations:
    """Build an environment's terminations: the default ones, in their order, with changes.

    Args:
        terminations: by name: a function of a StepState adds one, after the default ones, or replaces one of them; None
            switches a default one off. Each environment takes a copy.

    Raises:
        SpecError: a name or a value is wrong; the message names argument, value and choices.
    """
    functions = dict(DEFAULT_TERMINATIONS)
    if not isinstance(terminations, Mapping | None):
        raise SpecError(f"terminations={terminations!r} must be a mapping of names to functions")
    for name, value in (terminations or {}).items():
        if value is None:
            check_choice("terminations: default one", name, tuple(DEFAULT_TERMINATIONS))
            del functions[name]
        elif callable(value) and isinstance(name, str) and name:
            functions[name] = _Checked(name, copy.deepcopy(value))
        else:
            raise SpecError(f"terminations[{name!r}]={value!r} must be a function of a StepState or None (off)")
    return Terminations(functions)


@dataclass(frozen=True)
class _Checked:
    """A termination of one's own, whose mistakes are reported by name."""

    name: str
    fn: TerminationFunction

    def __call__(self, state: StepState) -> bool:
        value = self.fn(state)
        if not isinstance(value, bool | np.bool_):
            raise SpecError(f"terminations[{self.name!r}] returned {value!r}, must be True or False")
        return bool(value)
