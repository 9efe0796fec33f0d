"""One episode: a policy on an environment, and what it achieved."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium as gym
import numpy as np

from policies.statistics import root_mean_square
from stair_env.observation import STAIR_KEY
from stair_env.task.block_error import block_error

MM = 1000.0
COMPARED = {"width": "step_width", "height": "step_height", "distance": "edge_distance"}  # error -> field of the block
ERRORS = (*COMPARED, "same_edge_distance")
StepHook = Callable[[Mapping[str, Any], Mapping[str, Any]], None]


class Predictor(Protocol):
    """What acts: a `policies.pretrained.Policy`, an SB3 model, or one of CONTROLS."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Action and the policy's memory."""


class ZeroAction:
    """The gait alone: nothing is modulated.

    Args:
        action_space: of the environment.
    """

    def __init__(self, action_space: gym.Space) -> None:
        self._action = np.zeros(action_space.shape or (), np.float32)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Zeros, whatever is seen."""
        return self._action, state


class RandomAction:
    """Any action is as likely as any other; an episode's first observation seeds them, so that it can be repeated.

    Args:
        action_space: of the environment.
    """

    def __init__(self, action_space: gym.Space) -> None:
        self._shape = action_space.shape or ()

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """A drawn action; the memory is the generator."""
        if state is None:
            state = np.random.default_rng(zlib.crc32(observation["proprio"].tobytes()))
        return state.uniform(-1.0, 1.0, self._shape).astype(np.float32), state


CONTROLS: dict[str, Callable[[gym.Space], Predictor]] = {"zero": ZeroAction, "random": RandomAction}  # need no training


@dataclass(frozen=True)
class Episode:
    """Outcome of an episode; JSON-able.

    Attributes:
        seed: it was reset with.
        success: both rear feet on the landing, upright.
        steps_climbed, num_steps: edges got behind it, and how many there are.
        control_steps: length.
        total_reward: sum of the rewards.
        termination: why it ended, "time_limit" when it ran out of time.
        distance_m: walked along x.
        energy_j: mechanical work of the joints, positive and negative counted alike.
        riser_hits: control steps in which a foot struck a riser, summed over feet.
        seen: control steps in which the truth has stairs ahead.
        measured: those of them in which the observation has, too.
        same_edge: those of them in which both speak of the same edge (`stair_env.task.block_error`).
        squared_error_mm2: sums of the squared differences of width, height and distance (to the next edge) over
            `measured`, and of same_edge_distance over `same_edge`.
    """

    seed: int
    success: bool
    steps_climbed: int
    num_steps: int
    control_steps: int
    total_reward: float
    termination: str
    distance_m: float
    energy_j: float
    riser_hits: int
    seen: int
    measured: int
    same_edge: int
    squared_error_mm2: dict[str, float]


def run_episode(
    env: gym.Env,
    policy: Predictor,
    seed: int,
    *,
    options: Mapping[str, Any] | None = None,
    on_step: StepHook | None = None,
) -> Episode:
    """Run one episode to its end.

    Args:
        env: a climbing environment.
        policy: what acts.
        seed: of the episode.
        options: of `env.reset`.
        on_step: called with observation and info after reset and after each step.
    """
    observation, info = env.reset(seed=seed, options=dict(options) if options else None)
    start_x = info["truth"]["position"][0]
    tally = _Tally()
    total, steps, state = 0.0, 0, None
    terminated = truncated = False
    if on_step:
        on_step(observation, info)
    while not (terminated or truncated):
        action, state = policy.predict(observation, state, np.array([steps == 0]), deterministic=True)
        observation, reward, terminated, truncated, info = env.step(action)
        total, steps = total + float(reward), steps + 1
        tally.add(observation, info["truth"])
        if on_step:
            on_step(observation, info)
    truth = info["truth"]
    return Episode(
        seed=seed,
        success=bool(info["is_success"]),
        steps_climbed=int(info["steps_climbed"]),
        num_steps=int(truth["num_steps"]),
        control_steps=steps,
        total_reward=total,
        termination=str(info.get("termination") or "time_limit"),
        distance_m=float(truth["position"][0] - start_x),
        energy_j=float(truth["energy_j"]),
        riser_hits=tally.riser_hits,
        seen=tally.seen,
        measured=tally.measured,
        same_edge=tally.same_edge,
        squared_error_mm2=tally.squared_error_mm2,
    )


class _Tally:
    """Sums over an episode's control steps."""

    def __init__(self) -> None:
        self.riser_hits = self.seen = self.measured = self.same_edge = 0
        self.squared_error_mm2 = dict.fromkeys(ERRORS, 0.0)

    def add(self, observation: Mapping[str, Any], truth: Mapping[str, Any]) -> None:
        self.riser_hits += int(truth["riser_hits"])
        if truth["valid"] < 0.5:
            return
        self.seen += 1
        error = block_error(observation[STAIR_KEY], truth) if STAIR_KEY in observation else None
        if error is None:
            return
        self.measured += 1
        errors = {name: getattr(error, field) for name, field in COMPARED.items()}
        if error.same_edge:
            self.same_edge += 1
            errors["same_edge_distance"] = error.edge_distance
        for name, metres in errors.items():
            self.squared_error_mm2[name] += float((metres * MM) ** 2)


def measurement_summary(episodes: Sequence[Episode]) -> dict[str, Any]:
    """How well the stair block agrees with the truth over some episodes.

    Returns:
        `valid_fraction` of the control steps with stairs ahead, `same_edge_fraction` of the valid ones, and `rmse_mm`
        with a number, or None where nothing was measured, for each of ERRORS.
    """
    seen, measured, same_edge = (sum(getattr(e, name) for e in episodes) for name in ("seen", "measured", "same_edge"))
    counts = {**dict.fromkeys(COMPARED, measured), "same_edge_distance": same_edge}
    return {
        "valid_fraction": measured / max(seen, 1),
        "same_edge_fraction": same_edge / max(measured, 1),
        "rmse_mm": {
            name: root_mean_square(sum(e.squared_error_mm2[name] for e in episodes), counts[name]) for name in ERRORS
        },
    }
