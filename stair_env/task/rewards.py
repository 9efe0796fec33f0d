"""Reward terms: functions of a control step, weighted and added up by name."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from stair_env.common.validation import SpecError, check_choice
from stair_env.task.step_state import FAILURES, WANTED_SPEED, StepState, distance_to_edge
from stair_env.task.terms.legged_rewards import OPTIONAL_REWARDS

NOSING_DANGER_M = 0.03

RewardFunction = Callable[[StepState], float]


@dataclass(frozen=True)
class RewardTerm:
    """A term of the reward.

    Attributes:
        fn: of a control step; importable, or of a kind that cloudpickle can send to worker processes.
        weight: factor on what it returns.

    Raises:
        SpecError: fn cannot be called, or the weight is no finite number.
    """

    fn: RewardFunction
    weight: float = 1.0

    def __post_init__(self) -> None:
        if not callable(self.fn):
            raise SpecError(f"fn={self.fn!r} of a RewardTerm must be a function of a StepState")
        if not is_number(self.weight):
            raise SpecError(f"weight={self.weight!r} of a RewardTerm must be a finite number")


@dataclass(frozen=True)
class RewardWeights:
    """Weight of each default term; with 0 it is zero."""

    progress: float = 1.0
    heading: float = 0.1
    upright: float = 0.1
    action_rate: float = 0.02
    action_size: float = 0.01
    riser_hit: float = 0.1
    nosing: float = 0.05
    step_bonus: float = 1.0
    success: float = 10.0
    fall: float = 10.0


REWARD_TERMS = tuple(field.name for field in fields(RewardWeights))


def progress(state: StepState) -> float:
    """Speed along the walking direction as a share of the wanted speed, -1 to 1; going faster earns nothing."""
    speed = (state.after.position[0] - state.before.position[0]) / state.dt_s
    return float(min(max(speed, -WANTED_SPEED), WANTED_SPEED)) / WANTED_SPEED


def heading(state: StepState) -> float:
    """Minus the squared heading, rad²."""
    return -(state.after.yaw**2)


def upright(state: StepState) -> float:
    """Minus ten times the squared tilt, rad², measured from 0.8 of the slope under the feet."""
    up = state.after.rotation[2].tolist()  # world z in the base frame
    nose_up = math.atan2(up[0], math.hypot(up[1], up[2]))
    roll = math.atan2(up[1], up[2])
    tilt = (nose_up - 0.8 * state.slope_rad) ** 2 + roll**2
    return -tilt * 10.0


def action_rate(state: StepState) -> float:
    """Minus the squared change of the action."""
    change = state.action - state.previous_action
    return -float(np.dot(change, change))


def action_size(state: StepState) -> float:
    """Minus the squared action."""
    return -float(np.dot(state.action, state.action))


def riser_hit(state: StepState) -> float:
    """Minus the number of feet that run into something upright."""
    return -float(state.riser_hits)


def nosing(state: StepState) -> float:
    """Minus the number of feet that stand so close to an edge that they may slip off."""
    edges, feet = state.episode.profile.plain[0], zip(state.contacts.touching.tolist(), state.feet[:, 0].tolist())
    return -float(sum(touches and distance_to_edge(edges, x) < NOSING_DANGER_M for touches, x in feet))


def step_bonus(state: StepState) -> float:
    """Number of edges that the robot got behind it for the first time."""
    return float(state.new_steps)


def success(state: StepState) -> float:
    """1 when the robot has arrived."""
    return float(state.termination == "success")


def fall(state: StepState) -> float:
    """-1 when the episode ended with a failure."""
    return -float(state.termination in FAILURES)


DEFAULT_REWARDS: dict[str, RewardFunction] = {
    fn.__name__: fn
    for fn in (progress, heading, upright, action_rate, action_size, riser_hit, nosing, step_bonus, success, fall)
}


class Rewards:
    """The terms of an environment's reward.

    Args:
        terms: by name.
    """

    def __init__(self, terms: Mapping[str, RewardTerm]) -> None:
        self.terms = dict(terms)
        self._parts = [(name, term.weight, term.fn) for name, term in terms.items()]

    def weighted(self, state: StepState) -> dict[str, float]:
        """Return each term times its weight, by name; the reward is their sum."""
        return {name: weight * fn(state) for name, weight, fn in self._parts}


def read_rewards(
    rewards: Mapping[str, Any] | None = None, reward_weights: Mapping[str, float] | None = None
) -> Rewards:
    """Build an environment's reward: the default terms with changes.

    Args:
        rewards: by name: a RewardTerm adds a term or replaces a default one, a number is the weight of a default or an
            optional term (`stair_env.task.terms.legged_rewards`), None switches a default term off. Each environment
            takes a copy.
        reward_weights: weights of default terms.

    Raises:
        SpecError: a name or a value is wrong; the message names argument, value and choices.
    """
    weights = asdict(read_weights(reward_weights))
    terms = {name: RewardTerm(fn, weights[name]) for name, fn in DEFAULT_REWARDS.items()}
    if not isinstance(rewards, Mapping | None):
        raise SpecError(f"rewards={rewards!r} must be a mapping of names to RewardTerms")
    for name, value in (rewards or {}).items():
        if isinstance(value, RewardTerm):
            terms[name] = RewardTerm(_Checked(name, copy.deepcopy(value.fn)), value.weight)
        elif value is None:
            check_choice("rewards: default term", name, REWARD_TERMS)
            del terms[name]
        elif is_number(value):
            check_choice("rewards: default or optional term", name, (*REWARD_TERMS, *OPTIONAL_REWARDS))
            fn = DEFAULT_REWARDS[name] if name in DEFAULT_REWARDS else OPTIONAL_REWARDS[name]()
            terms[name] = RewardTerm(fn, float(value))
        else:
            raise SpecError(f"rewards[{name!r}]={value!r} must be a RewardTerm, a finite number (weight) or None (off)")
    return Rewards(terms)


def read_weights(changes: Mapping[str, float] | None) -> RewardWeights:
    """The default weights with changes.

    Raises:
        SpecError: a name is unknown or a value not finite.
    """
    for name, value in (changes or {}).items():
        check_choice("reward_weights field", name, REWARD_TERMS)
        if not np.isfinite(value):
            raise SpecError(f"reward_weights[{name!r}]={value!r} must be finite")
    return RewardWeights(**(changes or {}))


def is_number(value: object) -> bool:
    """Whether a value is a finite number and no truth value."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool) and bool(np.isfinite(value))


@dataclass(frozen=True)
class _Checked:
    """A term of one's own, whose mistakes are reported by name."""

    name: str
    fn: RewardFunction

    def __call__(self, state: StepState) -> float:
        value = self.fn(state)
        if not is_number(value):
            raise SpecError(f"rewards[{self.name!r}] returned {value!r}, must be a finite number")
        return float(value)
