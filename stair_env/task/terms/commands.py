"""A velocity to follow, drawn for each episode, as locomotion policies are commanded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces

from stair_env.common.field_kinds import naming_fields
from stair_env.common.validation import as_range, check_range, from_mapping
from stair_env.task.step_state import NO_COMMAND, Command, StepState

Range = tuple[float, float]
COMMAND_KEY = "command"  # of the observation
COMMAND_FIELDS = ("forward", "lateral", "turn")
MAX_SPEED_M_S, MAX_TURN_RAD_S = 2.0, 2.0


@dataclass(frozen=True)
class CommandConfig:
    """From what velocities are drawn, uniformly; each a number or [low, high].

    Attributes:
        forward, lateral: of the base, frame that turns with it, m/s; lateral is positive to the left.
        turn: rad/s, positive to the left.
        interval_s: a new one is drawn after so long; 0 keeps one for the episode.

    Raises:
        SpecError: a value is out of range.
    """

    forward: Range = (0.2, 0.5)
    lateral: Range = (0.0, 0.0)
    turn: Range = (0.0, 0.0)
    interval_s: float = 0.0

    @naming_fields
    def __post_init__(self) -> None:
        for name in ("forward", "lateral"):
            span = as_range(f"command.{name}", getattr(self, name), -MAX_SPEED_M_S, MAX_SPEED_M_S)
            object.__setattr__(self, name, span)
        object.__setattr__(self, "turn", as_range("command.turn", self.turn, -MAX_TURN_RAD_S, MAX_TURN_RAD_S))
        check_range("command.interval_s", self.interval_s, 0.0, 1e4)


class Commands:
    """Draws the commands of an episode.

    Args:
        config: from what; None commands nothing.
    """

    def __init__(self, config: CommandConfig | None) -> None:
        self.config = config
        self._command = NO_COMMAND

    def reset(self, rng: np.random.Generator) -> Command:
        """Begin an episode, and return its first command."""
        self._rng, self._next_s = rng, 0.0
        return self.at(0.0)

    def at(self, time_s: float) -> Command:
        """The command at a time that never goes back, seconds since the episode began."""
        config = self.config
        if config is not None and time_s >= self._next_s:
            spans = (config.forward, config.lateral, config.turn)
            forward, lateral, turn = (float(self._rng.uniform(*span)) for span in spans)
            self._command = Command(forward, lateral, turn)
            self._next_s = time_s + config.interval_s if config.interval_s else math.inf
        return self._command


def read_command(value: Any) -> Commands:
    """None or False: none. True: the defaults. A number or [low, high]: forward, m/s. A mapping: of CommandConfig.

    Raises:
        SpecError: anything else, or a wrong field.
    """
    if value is None or value is False:
        return Commands(None)
    if value is True:
        return Commands(CommandConfig())
    if isinstance(value, CommandConfig):
        return Commands(value)
    if isinstance(value, Mapping):
        return Commands(from_mapping("command", CommandConfig, value))
    return Commands(CommandConfig(forward=as_range("command", value, -MAX_SPEED_M_S, MAX_SPEED_M_S)))


def command_space() -> spaces.Box:
    """Space of the command, in the order of COMMAND_FIELDS."""
    bound = np.array([MAX_SPEED_M_S, MAX_SPEED_M_S, MAX_TURN_RAD_S], np.float32)
    return spaces.Box(-bound, bound, dtype=np.float32)


def pack_command(state: StepState) -> np.ndarray:
    """(3,) float32 of a control step."""
    return np.array(state.command, np.float32)
