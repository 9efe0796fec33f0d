"""Reward terms that learning without a gait needs; off unless `rewards` gives them a weight.

Names and meanings follow legged_gym (Rudin et al., "Learning to Walk in Minutes", CoRL 2021), on this environment's 48
control steps a second. A term that looks back is a class: each environment has one of its own, and an episode begins
it anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from stair_env.task.step_state import Episode, StepState

TRACKING_SIGMA = 0.25  # (m/s)² and (rad/s)², at which a share of 1/e is left
SWING_S = 0.2  # a swing as long as this earns nothing, a longer one does (the gait's take 0.16)

RewardFunction = Callable[[StepState], float]


def track_velocity(state: StepState) -> float:
    """How well the horizontal velocity is the commanded one, 0 to 1."""
    base, command = state.after, state.command
    cos, sin = math.cos(base.yaw), math.sin(base.yaw)
    x, y, _ = base.velocity.tolist()
    forward, left = cos * x + sin * y, cos * y - sin * x
    return math.exp(-((forward - command.forward) ** 2 + (left - command.lateral) ** 2) / TRACKING_SIGMA)


def track_turn(state: StepState) -> float:
    """How well the rate of turning is the commanded one, 0 to 1."""
    return math.exp(-((float(state.after.angular_velocity[2]) - state.command.turn) ** 2) / TRACKING_SIGMA)


def torque(state: StepState) -> float:
    """Minus the squared torques, (N·m)²."""
    return -float(np.dot(state.joint_torques, state.joint_torques))


def power(state: StepState) -> float:
    """Minus the mechanical power of the joints, braking counted as work, W."""
    return -state.joint_power_w


def foot_slip(state: StepState) -> float:
    """Minus the squared horizontal speed of the feet that stand, (m/s)²."""
    moved = state.foot_velocities[:, :2]
    return -float(np.sum(state.contacts.touching * np.sum(moved * moved, axis=1)))


def trunk_rate(state: StepState) -> float:
    """Minus the squared rates of roll and pitch, (rad/s)²."""
    roll, pitch, _ = (state.after.rotation.T @ state.after.angular_velocity).tolist()
    return -(roll**2 + pitch**2)


def hip_spread(state: StepState) -> float:
    """Minus the squared abduction of the four hips, rad²."""
    hips = state.joint_positions[::3]
    return -float(np.dot(hips, hips))


def collision(state: StepState) -> float:
    """-1 while something else than a foot touches the ground."""
    return -float(state.contacts.body_touches)


class LooksBack:
    """A term that needs more than one control step; `begin` is called with the first one of each episode."""

    _episode: Episode | None = None

    def __call__(self, state: StepState) -> float:
        """The term's value."""
        if state.episode is not self._episode:
            self._episode = state.episode
            self.begin(state)
        return self.value(state)

    def begin(self, state: StepState) -> None:
        """Forget what was."""

    def value(self, state: StepState) -> float:
        """The term's value, given what was seen before."""
        raise NotImplementedError


class AirTime(LooksBack):
    """Seconds beyond SWING_S that feet were in the air, counted as each touches down."""

    def begin(self, state: StepState) -> None:
        """All feet stand."""
        self._aloft_s = np.zeros(4)

    def value(self, state: StepState) -> float:
        """Sum over the feet that touched down."""
        touching = state.contacts.touching
        landed = touching & (self._aloft_s > 0.0)
        earned = float(np.sum(self._aloft_s[landed] - SWING_S))
        self._aloft_s = np.where(touching, 0.0, self._aloft_s + state.dt_s)
        return earned


class Smoothness(LooksBack):
    """Minus the squared second difference of the action."""

    def begin(self, state: StepState) -> None:
        """The action before the first two was none."""
        self._before = state.previous_action

    def value(self, state: StepState) -> float:
        """Of this and the two last actions."""
        bend = state.action - 2.0 * state.previous_action + self._before
        self._before = state.previous_action
        return -float(np.dot(bend, bend))


class JointAcceleration(LooksBack):
    """Minus the squared accelerations of the joints over a control step, (rad/s²)²."""

    def begin(self, state: StepState) -> None:
        """Nothing is known of the step before."""
        self._velocities = state.joint_velocities

    def value(self, state: StepState) -> float:
        """From this and the last control step's velocities."""
        change = (state.joint_velocities - self._velocities) / state.dt_s
        self._velocities = state.joint_velocities
        return -float(np.dot(change, change))


OPTIONAL_REWARDS: dict[str, Callable[[], RewardFunction]] = {
    **{
        fn.__name__: (lambda fn=fn: fn)  # type: ignore[misc]
        for fn in (track_velocity, track_turn, torque, power, foot_slip, trunk_rate, hip_spread, collision)
    },
    "air_time": AirTime,
    "smoothness": Smoothness,
    "joint_acceleration": JointAcceleration,
}
