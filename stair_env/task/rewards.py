"""Reward terms: pure functions of a control step's outcome, added up by name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from stair_env.common.validation import SpecError, check_choice
from stair_env.physics.simulation import BaseState, FootContacts
from stair_env.stairs import StairProfile

WANTED_SPEED = 0.35  # m/s; going faster earns nothing
NOSING_DANGER_M = 0.03
RISER_HIT_MIN_N = 5.0  # a lighter touch is none
RISER_HIT_RATIO = 4.0  # a foot that is pushed sideways this much harder than it is carried has hit a riser


@dataclass(frozen=True)
class RewardWeights:
    """Weight of each term; 0 switches it off."""

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


class StepOutcome(NamedTuple):
    """What the terms are computed from.

    Attributes:
        before, after: base state at the start and the end of the control step.
        feet: (4, 3) world, metres, plain numbers.
        contacts: at the end of the step.
        riser_hits: feet that ran into something upright, see `riser_hits`.
        action, last_action: (n,) in [-1, 1].
        new_steps: edges that the robot got behind it for the first time (negative: fell back).
        slope_rad: nose-up pitch that suits the ground under the feet.
        success, fell: how the step ended.
        dt: control step, seconds.
    """

    before: BaseState
    after: BaseState
    feet: list[list[float]]
    contacts: FootContacts
    riser_hits: int
    action: np.ndarray
    last_action: np.ndarray
    new_steps: int
    slope_rad: float
    success: bool
    fell: bool
    dt: float


def reward_terms(outcome: StepOutcome, profile: StairProfile, weights: RewardWeights) -> dict[str, float]:
    """Weighted terms by name; the reward is their sum.

    Args:
        outcome: of one control step.
        profile: side view of the stairs.
        weights: of each term.

    Returns:
        One float per field of RewardWeights, penalties negative.
    """
    speed = (outcome.after.position[0] - outcome.before.position[0]) / outcome.dt
    up = outcome.after.rotation[2].tolist()  # world z in the base frame
    nose_up = math.atan2(up[0], math.hypot(up[1], up[2]))
    roll = math.atan2(up[1], up[2])
    change = outcome.action - outcome.last_action
    tilt = (nose_up - 0.8 * outcome.slope_rad) ** 2 + roll**2
    raw = {
        "progress": float(min(max(speed, -WANTED_SPEED), WANTED_SPEED)) / WANTED_SPEED,
        "heading": -(outcome.after.yaw**2),
        "upright": -tilt * 10.0,
        "action_rate": -float(np.dot(change, change)),
        "action_size": -float(np.dot(outcome.action, outcome.action)),
        "riser_hit": -float(outcome.riser_hits),
        "nosing": -float(sum(feet_near_nosing(outcome.feet, outcome.contacts, profile))),
        "step_bonus": float(outcome.new_steps),
        "success": float(outcome.success),
        "fall": -float(outcome.fell),
    }
    return {name: weight * raw[name] for name, weight in vars(weights).items()}


def riser_hits(contacts: FootContacts) -> list[bool]:
    """Which of the four feet run into something upright."""
    return [
        touches and math.hypot(x, y) > max(RISER_HIT_RATIO * abs(z), RISER_HIT_MIN_N)
        for touches, (x, y, z) in zip(contacts.touching.tolist(), contacts.force.tolist())
    ]


def feet_near_nosing(feet: list[list[float]], contacts: FootContacts, profile: StairProfile) -> list[bool]:
    """Which of the four feet stand so close to an edge that they may slip off."""
    return [
        touches and profile.distance_to_edge(x) < NOSING_DANGER_M
        for touches, (x, _, _) in zip(contacts.touching.tolist(), feet)
    ]
