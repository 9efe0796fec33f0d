"""The simulated D435i as a source: a robot trots towards stairs, its camera's frames and IMU come out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from perception.lens.lenses import Lens
from perception.sources.source import ImuSamples, RawFrame

SUBSTEP_S = 1.0 / 240.0


class SimulatedSource:
    """Frames of `stair_env/StairClimbRGBD-v0`, of which the gait alone walks.

    Depth is aligned as the environment aligns it; IMU samples come at 240 Hz.

    Args:
        frames: how many.
        seed: of the first episode; later ones follow.
        env_kwargs: arguments of `stair_env.rgbd.StairClimbRgbdEnv`.
    """

    def __init__(self, frames: int = 60, seed: int = 0, **env_kwargs: Any) -> None:
        if frames < 1:
            raise ValueError(f"frames={frames!r} must be at least 1")
        self._count, self._seed, self._kwargs = frames, seed, {"stair_source": "oracle", **env_kwargs}
        self._env: Any = None

    @property
    def name(self) -> str:
        """ "simulated D435i"."""
        return "simulated D435i"

    def __len__(self) -> int:
        """How many frames were asked for."""
        return self._count

    def __iter__(self) -> Iterator[RawFrame]:
        """Walk, and yield each new frame; a flight that ends is followed by another."""
        from stair_env.rgbd import StairClimbRgbdEnv

        self.close()
        env = self._env = StairClimbRgbdEnv(**self._kwargs)
        action = np.zeros(env.action_space.shape or (), np.float32)
        observation, info = env.reset(seed=self._seed)
        start_s, last, given, samples = 0.0, None, 0, []
        while given < self._count:
            camera = info["camera"]
            samples.append(_stamped(observation["imu"], start_s + camera["time_s"]))
            if camera["frame"] != last:
                last = camera["frame"]
                imu = np.concatenate(samples)
                samples = []
                yield RawFrame(
                    name=f"frame_{given:06d}",
                    time_s=start_s + camera["captured_at_s"],
                    rgb=observation["rgb"],
                    depth_m=observation["depth"],
                    lens=Lens(env.camera_intrinsics),
                    imu=ImuSamples(imu[:, :4], imu[:, [0, 4, 5, 6]]),
                )
                given += 1
            observation, _, terminated, _, info = env.step(action)
            if terminated:
                start_s += info["camera"]["time_s"] + 1.0
                observation, info = env.reset()
                last = None
        self.close()

    def close(self) -> None:
        """End the simulation; safe to call twice."""
        if self._env is not None:
            self._env.close()
            self._env = None


def _stamped(imu: np.ndarray, end_s: float) -> np.ndarray:
    """(k, 7): times and the samples of one control step, the last of which was taken at its end."""
    times = end_s - SUBSTEP_S * np.arange(len(imu) - 1, -1, -1.0)
    return np.column_stack([times, imu.astype(np.float64)])
