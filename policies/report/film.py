"""Filming episodes: the onlooker's picture, beside it the robot's own where it has a camera."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from policies.report.camera_view import camera_view
from policies.report.film_layout import FAINT, TEXT, compose, measurement_words
from policies.rollout import Episode
from stair_env.common.files import atomic_path
from stair_env.physics.simulation import CONTROL_RATE_HZ

STEPS_PER_FRAME = 4  # 12 frames a second: the robot's camera takes 15
HOLD_FRAMES = 8  # of the last picture
CRF = "26"  # H.264's constant quality: 18 looks lossless, 28 soft
ONLOOKER_ATTRIBUTE = "onlooker_view"  # of stair_env.rgbd.StairClimbRgbdEnv


@contextlib.contextmanager
def open_video(path: Path | str) -> Iterator[Any]:
    """A writer of pictures (`append_data`); the file appears when the block ends without an error."""
    import imageio.v2 as imageio

    with atomic_path(path) as temporary:
        rate = CONTROL_RATE_HZ / STEPS_PER_FRAME
        options: dict[str, Any] = {
            "codec": "libx264",
            "quality": None,
            "output_params": ["-crf", CRF, "-preset", "veryfast"],
        }
        with imageio.get_writer(temporary, fps=rate, macro_block_size=16, **options) as writer:
            yield writer


class Film:
    """Takes a picture every few control steps.

    Args:
        env: made with render_mode="rgb_array".
        writer: of `open_video`.
        title: written under every picture.
        on_step: called after each control step.
    """

    def __init__(self, env: gym.Env, writer: Any, title: str, on_step: Callable[[], None] | None = None) -> None:
        self._env, self._writer, self._title, self._on_step = env, writer, title, on_step
        self._steps = 0
        self._last: tuple[Mapping[str, Any], Mapping[str, Any]] | None = None

    def add(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> None:
        """Take notice of a control step; the hook of `policies.rollout.run_episode`."""
        if self._steps % STEPS_PER_FRAME == 0:
            self._writer.append_data(self._picture(observation, info))
        self._last = (observation, info)
        self._steps += 1
        if self._on_step:
            self._on_step()

    def finish(self, episode: Episode) -> None:
        """Hold the last picture with the outcome."""
        assert self._last is not None
        outcome = "arrived" if episode.success else f"ended by {episode.termination}"
        picture = self._picture(*self._last, outcome)
        for _ in range(HOLD_FRAMES):
            self._writer.append_data(picture)

    def _picture(self, observation: Mapping[str, Any], info: Mapping[str, Any], outcome: str = "") -> np.ndarray:
        truth = info["truth"]
        first = [
            (self._title, TEXT),
            (f"step {info['steps_climbed']} of {truth['num_steps']}", FAINT),
            (outcome, TEXT),
        ]
        return compose(
            self._onlooker_view(), camera_view(self._env), [first, measurement_words(observation["stair"], truth)]
        )

    def _onlooker_view(self) -> np.ndarray:
        """Ray-cast where the environment has a scene with materials and light, else what `render()` shows."""
        ray_cast = self._env.has_wrapper_attr(ONLOOKER_ATTRIBUTE)
        view: Any = self._env.get_wrapper_attr(ONLOOKER_ATTRIBUTE)() if ray_cast else self._env.render()
        return np.asarray(view)
