"""Parts of the observation beyond what the sensors give: the privileged block, and parts of one's own."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces

from stair_env.common.validation import SpecError, check_choice, from_mapping
from stair_env.observation import PRIVILEGED_KEY, STAIR_KEY
from stair_env.task.privileged import pack_privileged, privileged_space
from stair_env.task.step_state import StepState
from stair_env.task.terms.commands import COMMAND_KEY, command_space, pack_command
from stair_env.task.terms.height_scan import HEIGHT_SCAN_KEY, HeightScan, HeightScanConfig, height_scan_space

OBSERVATION_SETS = ("stairs", "height_scan", "proprio")
ObservationFunction = Callable[[StepState], np.ndarray]


@dataclass(frozen=True)
class ObservationTerm:
    """A part of the observation.

    Attributes:
        fn: returns the part after a control step, or at a reset; importable, or of a kind that cloudpickle can send to
            worker processes.
        space: of what it returns, which is cast to the space's dtype and clipped to its bounds.

    Raises:
        SpecError: fn cannot be called, or space is no Box.
    """

    fn: ObservationFunction
    space: spaces.Box

    def __post_init__(self) -> None:
        if not callable(self.fn):
            raise SpecError(f"fn={self.fn!r} of an ObservationTerm must be a function of a StepState")
        if not isinstance(self.space, spaces.Box):
            raise SpecError(f"space={self.space!r} of an ObservationTerm must be a Box")


class Observations:
    """Which parts an environment's observation has.

    Args:
        sensed: space of each part that the sensors give.
        hidden: names of those that are left out.
        terms: further parts by name.

    Attributes:
        space: of the observation.
        changes: whether it differs from what the sensors give.
    """

    def __init__(
        self, sensed: Mapping[str, spaces.Space[Any]], hidden: set[str], terms: Mapping[str, ObservationTerm]
    ) -> None:
        self._hidden, self._terms = hidden, dict(terms)
        self.changes = bool(hidden or terms)
        kept = {key: space for key, space in sensed.items() if key not in hidden}
        self.space = spaces.Dict({**kept, **{name: term.space for name, term in terms.items()}})

    def select(self, sensed: dict[str, np.ndarray], state: StepState) -> dict[str, np.ndarray]:
        """Return the observation.

        Args:
            sensed: what the sensors give, by name.
            state: of the control step.
        """
        for key in self._hidden:
            del sensed[key]
        for name, term in self._terms.items():
            sensed[name] = term.fn(state)
        return sensed


def read_observations(
    observations: str | Mapping[str, Any] | None,
    privileged: bool,
    sensed: Mapping[str, spaces.Space[Any]],
    commanded: bool = False,
) -> Observations:
    """Build an environment's observation: what its sensors give, with changes.

    Args:
        observations: name in OBSERVATION_SETS: with the stair block, or a height scan or nothing in its place. Or by
            name: an ObservationTerm adds a part, None leaves out one that the sensors give, and "height_scan" takes
            fields of HeightScanConfig. Each environment takes a copy.
        privileged: whether there is the privileged block.
        sensed: space of each part that the sensors give.
        commanded: whether there is a velocity command.

    Raises:
        SpecError: a name or a value is wrong; the message names argument, value and choices.
    """
    if not isinstance(privileged, bool):
        raise SpecError(f"privileged={privileged!r} must be True or False")
    if isinstance(observations, str):
        observations = _named_set(observations, sensed)
    if not isinstance(observations, Mapping | None):
        raise SpecError(f"observations={observations!r} must be a mapping of names to ObservationTerms")
    terms = {PRIVILEGED_KEY: ObservationTerm(pack_privileged, privileged_space())} if privileged else {}
    if commanded:
        terms[COMMAND_KEY] = ObservationTerm(pack_command, command_space())
    hidden: set[str] = set()
    for name, value in (observations or {}).items():
        if value is None:
            check_choice("observations: part", name, tuple(sensed))
            hidden.add(name)
        elif name == HEIGHT_SCAN_KEY and isinstance(value, Mapping):
            scan = HeightScan(from_mapping("height_scan", HeightScanConfig, value))
            terms[name] = ObservationTerm(scan, height_scan_space())
        elif not isinstance(value, ObservationTerm):
            raise SpecError(f"observations[{name!r}]={value!r} must be an ObservationTerm or None (left out)")
        elif name in sensed or name in terms:
            raise SpecError(f"observations[{name!r}] is taken, use another name than {', '.join((*sensed, *terms))}")
        else:
            terms[name] = ObservationTerm(_Checked(name, copy.deepcopy(value.fn), value.space), value.space)
    return Observations(sensed, hidden, terms)


def _named_set(name: str, sensed: Mapping[str, Any]) -> dict[str, Any]:
    """What a name in OBSERVATION_SETS stands for."""
    check_choice("observations", name, OBSERVATION_SETS)
    if name == "stairs":
        return {}
    if STAIR_KEY not in sensed:
        raise SpecError(
            f"observations={name!r} is for stair_env/StairClimb-v0; here say by name what to add, or to leave out "
            f"of {', '.join(sensed)}"
        )
    return {STAIR_KEY: None, **({HEIGHT_SCAN_KEY: {}} if name == "height_scan" else {})}


@dataclass(frozen=True)
class _Checked:
    """A part of one's own, brought into its space; a wrong shape is reported by name."""

    name: str
    fn: ObservationFunction
    space: spaces.Box

    def __call__(self, state: StepState) -> np.ndarray:
        value = np.asarray(self.fn(state))
        if value.shape != self.space.shape or not np.isfinite(value).all():
            raise SpecError(f"observations[{self.name!r}] returned {value!r}, must be finite, {self.space.shape}")
        part: np.ndarray = np.clip(value, self.space.low, self.space.high).astype(self.space.dtype)
        return part
