"""The shipped policy climbs on what its camera sees; a video and a summary say how it went."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from policies import pretrained
from policies.make_env import PERCEPTION_ID, make_env
from policies.report.film import Film, open_video
from policies.rollout import Episode, StepHook, measurement_summary, run_episode
from stair_env.common.constants import DEMO_LIGHTINGS, EPISODE_DIRECTIONS
from stair_env.common.field_kinds import naming_fields
from stair_env.common.validation import check_choice

MAX_STEPS = 720  # 15 s; a flight takes about 7
_LIGHTINGS = {"day": ("day",), "night": ("night",), "both": ("day", "night")}
_DIRECTIONS = {"up": ("up",), "down": ("down",), "both": ("up", "down")}


@dataclass(frozen=True)
class DemoConfig:
    """What is shown.

    Args:
        policy: shipped name or folder; None takes the robot's name.
        robot: which robot; None takes the policy's.
        episodes: flights to climb.
        direction: "up", "down", or "both" in turn.
        lighting: "day", "night", or "both" in turn.
        riser_height, tread_depth: metres, low and high.
        seed: of all flights.
        env_kwargs: further arguments of the environment.

    Raises:
        ValueError: a wrong value; the message names argument, value and choices.
    """

    policy: str | None = None
    robot: str | None = None
    episodes: int = 4
    direction: str = "both"
    lighting: str = "both"
    riser_height: tuple[float, float] = (0.09, 0.14)
    tread_depth: tuple[float, float] = (0.27, 0.33)
    seed: int = 0
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)

    @naming_fields
    def __post_init__(self) -> None:
        check_choice("direction", self.direction, EPISODE_DIRECTIONS)
        check_choice("lighting", self.lighting, DEMO_LIGHTINGS)
        if self.episodes < 1:
            raise ValueError(f"episodes={self.episodes!r} must be >= 1")
        object.__setattr__(self, "robot", pretrained.fitting_robot(self.robot, (self.policy,)))

    def flight(self, index: int) -> dict[str, Any]:
        """Direction and lighting of a flight: directions change first, then the light."""
        directions, lightings = _DIRECTIONS[self.direction], _LIGHTINGS[self.lighting]
        return {
            "direction": directions[index % len(directions)],
            "lighting": lightings[index // len(directions) % len(lightings)],
        }


def run_demo(
    config: DemoConfig, folder: Path | str, on_step: Callable[[], None] | None = None, rerun: Path | None = None
) -> dict[str, Any]:
    """Climb, film and summarise.

    Args:
        config: what to show.
        folder: gets `demo.mp4`.
        on_step: called after each control step.
        rerun: a recording for the Rerun viewer (.rrd), written beside the film.

    Returns:
        `success_rate`, `episodes`, `rmse_mm` by `policies.rollout.ERRORS`, `video`, and `flights` one by one.

    Raises:
        ValueError: no such policy or robot, or the policy does not fit.
    """
    policy_name = config.policy or str(config.robot)
    pretrained.locate(policy_name)
    video = Path(folder) / "demo.mp4"
    seeds = np.random.SeedSequence(config.seed).generate_state(config.episodes)
    flights: list[dict[str, Any]] = []
    episodes: list[Episode] = []
    with contextlib.ExitStack() as stack:
        opened = None
        if rerun is not None:
            from policies.report.flight_log import FlightLog, open_flights

            opened = stack.enter_context(open_flights(rerun))
        writer, time_s = stack.enter_context(open_video(video)), 0.0
        for index in range(config.episodes):
            setting = config.flight(index)
            title = f"flight {index + 1} of {config.episodes}: {setting['direction']}, {setting['lighting']}"
            env = _make_env(config, setting)
            try:
                film = Film(env, writer, title, on_step)
                policy = pretrained.load(policy_name, env)
                log = None if opened is None else FlightLog(opened, env, time_s)
                hook = film.add if log is None else _both(film.add, log.add)
                episode = run_episode(env, policy, int(seeds[index]), on_step=hook)
                time_s = 0.0 if log is None else log.time_s
                film.finish(episode)
            finally:
                env.close()
            episodes.append(episode)
            flights.append({**setting, **_describe(episode)})
    successes = sum(episode.success for episode in episodes)
    return {
        "success_rate": successes / len(episodes),
        "episodes": len(episodes),
        **measurement_summary(episodes),
        "video": str(video),
        "policy": policy_name,
        "flights": flights,
    }


def _both(first: StepHook, second: StepHook) -> StepHook:
    """A hook that calls two."""

    def hook(observation: Mapping[str, Any], info: Mapping[str, Any]) -> None:
        first(observation, info)
        second(observation, info)

    return hook


def _make_env(config: DemoConfig, setting: Mapping[str, Any]) -> gym.Env:
    kwargs = {
        "robot": config.robot,
        "riser_height": config.riser_height,
        "tread_depth": config.tread_depth,
        "render_mode": "rgb_array",
        "max_episode_steps": MAX_STEPS,
        **setting,
        **config.env_kwargs,
    }
    return make_env(PERCEPTION_ID, kwargs, monitor=False)


def _describe(episode: Episode) -> dict[str, Any]:
    kept = ("seed", "success", "steps_climbed", "num_steps", "control_steps", "termination")
    return {name: value for name, value in asdict(episode).items() if name in kept}
