"""What all environments of a run share, wherever they are: curriculum, statistics of observations and returns.

The process that trains owns it. Between iterations it collects what each environment has met since the last time, and
hands the sums out again: a runner that dies takes nothing with it, and one that is restarted gets everything.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from stair_env.task.curriculum import Curriculum

CLIP_REWARD, EPSILON = 10.0, 1e-8  # of SB3's VecNormalize
RECENT = 100  # episodes of which the curve shows means, as in SB3
LEVEL_KEY = "curriculum_level"


class Flown(NamedTuple):
    """An episode that is over: success, sum of rewards, length in control steps, level at its start (-1: none)."""

    success: bool
    total_reward: float
    length: int
    level: int


class Moments:
    """Count, mean and variance of arrays that come in batches.

    Args:
        shape: of one array.
    """

    def __init__(self, shape: tuple[int, ...] = ()) -> None:
        self.count, self.mean, self.square = 0.0, np.zeros(shape), np.zeros(shape)  # square: sum of squared deviations

    @property
    def var(self) -> np.ndarray:
        """Variance; ones before anything was counted."""
        return self.square / self.count if self.count else np.ones_like(self.mean)

    def add(self, values: np.ndarray) -> None:
        """Count one array."""
        self.count += 1.0
        difference = values - self.mean
        self.mean = self.mean + difference / self.count
        self.square = self.square + difference * (values - self.mean)

    def merge(self, other: Moments) -> None:
        """Count what another has counted (Chan, Golub, LeVeque: parallel variance)."""
        total = self.count + other.count
        if not other.count:
            return
        difference = other.mean - self.mean
        self.square = self.square + other.square + difference**2 * self.count * other.count / total
        self.mean = self.mean + difference * other.count / total
        self.count = total

    def state(self) -> dict[str, Any]:
        """JSON-able state."""
        return {"count": self.count, "mean": self.mean.tolist(), "square": self.square.tolist()}

    @classmethod
    def restored(cls, state: Mapping[str, Any]) -> Moments:
        """Continue from `state()`."""
        moments = cls(np.shape(state["mean"]))
        moments.count, moments.mean = float(state["count"]), np.asarray(state["mean"], dtype=np.float64)
        moments.square = np.asarray(state["square"], dtype=np.float64)
        return moments


@dataclasses.dataclass
class Report:
    """What one environment has met since it was asked last."""

    observations: dict[str, Moments]
    returns: Moments
    episodes: list[Flown]


class Reporting(gym.Wrapper[Any, Any, Any, Any]):
    """Counts what an environment meets, and scales its rewards by what all of them met.

    Args:
        env: a climbing environment behind `policies.make_env.CurriculumAccess`.
        keys: of the observation whose moments are counted.
        gamma: discount of the returns.
        norm_reward: whether rewards are scaled by the deviation of the discounted return.
    """

    def __init__(self, env: gym.Env, keys: Sequence[str], gamma: float, norm_reward: bool) -> None:
        super().__init__(env)
        self._keys, self._gamma, self._norm_reward = tuple(keys), gamma, norm_reward
        self._deviation = 1.0
        self._discounted = 0.0
        self._begin()
        self._total, self._length, self._level = 0.0, 0, -1

    def _begin(self) -> None:
        spaces: Any = self.env.observation_space
        self._report = Report({key: Moments(spaces[key].shape) for key in self._keys}, Moments(), [])

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(**kwargs)
        self._total, self._length, self._discounted = 0.0, 0, 0.0
        self._level = int(info.get(LEVEL_KEY, -1))
        self._count(observation)
        return observation, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One control step; the reward is scaled, and infos, which would all travel, stay here."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._count(observation)
        self._total, self._length = self._total + float(reward), self._length + 1
        self._discounted = self._gamma * self._discounted + float(reward)
        self._report.returns.add(np.asarray(self._discounted))
        if terminated or truncated:
            self._report.episodes.append(Flown(bool(info["is_success"]), self._total, self._length, self._level))
        scaled = float(np.clip(float(reward) / self._deviation, -CLIP_REWARD, CLIP_REWARD))
        return observation, scaled if self._norm_reward else float(reward), terminated, truncated, {}

    def _count(self, observation: Mapping[str, np.ndarray]) -> None:
        for key, moments in self._report.observations.items():
            moments.add(observation[key])

    def collect(self) -> Report:
        """What was met since the last call."""
        report = self._report
        self._begin()
        return report

    def share(self, curriculum: Mapping[str, Any] | None, return_var: float) -> None:
        """Go on with what all environments know: the curriculum's state and the variance of the return."""
        self._deviation = float(np.sqrt(return_var + EPSILON))
        env: Any = self.env
        env.set_curriculum_state(curriculum)


class RunState:
    """The sums over all environments.

    Args:
        observations: moments by key, empty at first.
        curriculum: of one environment, whose settings the shared one takes over; None where there is none.
        num_envs: how many environments report to the shared curriculum.

    Attributes:
        episodes: how many are over.
        recent: the last RECENT of them.
    """

    def __init__(self, observations: dict[str, Moments], curriculum: Curriculum | None, num_envs: int) -> None:
        self.observations, self.returns = observations, Moments()
        self.curriculum = None if curriculum is None else shared_curriculum(curriculum, num_envs)
        self.episodes = 0
        self.recent: deque[Flown] = deque(maxlen=RECENT)

    def absorb(self, reports: Sequence[Report]) -> None:
        """Add what environments have met; of episodes only those at the present level move the curriculum."""
        for report in reports:
            for key, moments in report.observations.items():
                self.observations[key].merge(moments)
            self.returns.merge(report.returns)
            self.episodes += len(report.episodes)
            self.recent.extend(report.episodes)
        if self.curriculum is None:
            return
        level = self.curriculum.level
        for episode in (episode for report in reports for episode in report.episodes):
            if episode.level == level == self.curriculum.level:
                self.curriculum.report(episode.success)

    def curriculum_state(self) -> dict[str, Any] | None:
        """For the environments, which are not to raise the level by themselves: without results."""
        return None if self.curriculum is None else {"level": self.curriculum.level, "results": []}

    def statistics(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Mean and variance by key."""
        return {key: (moments.mean, moments.var) for key, moments in self.observations.items()}

    def state(self) -> dict[str, Any]:
        """JSON-able state."""
        return {
            "observations": {key: moments.state() for key, moments in self.observations.items()},
            "returns": self.returns.state(),
            "curriculum": None if self.curriculum is None else self.curriculum.state(),
            "episodes": self.episodes,
            "recent": [list(episode) for episode in self.recent],
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from `state()`."""
        self.observations = {key: Moments.restored(value) for key, value in state["observations"].items()}
        self.returns = Moments.restored(state["returns"])
        if self.curriculum is not None and state["curriculum"] is not None:
            self.curriculum.restore(state["curriculum"])
        self.episodes = int(state["episodes"])
        self.recent = deque((Flown(*values) for values in state["recent"]), maxlen=RECENT)


def shared_curriculum(own: Curriculum, num_envs: int) -> Curriculum:
    """One curriculum for many environments: as that of one, but it looks at an episode of each at least."""
    config = dataclasses.replace(own.config, window=max(own.config.window, num_envs))
    return Curriculum(config, own.highest)
