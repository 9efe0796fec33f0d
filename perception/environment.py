"""What `gym.make("stair_env/StairClimbPerception-v0")` builds."""

from __future__ import annotations

from typing import Any

from perception.wrapper import PerceptionWrapper
from stair_env.rgbd import StairClimbRgbdEnv


def make_perception_env(estimator: dict[str, Any] | None = None, **kwargs: Any) -> PerceptionWrapper:
    """The RGBD environment seen through StairNetV2.

    Args:
        estimator: keyword arguments of `StairEstimator`, for example {"width": 0.5, "backend": "torch"}.
        kwargs: see `StairClimbRgbdEnv`.

    Raises:
        SpecError: (a ValueError) an argument is wrong; the message names it, its value and the choices.
    """
    from perception.estimator import StairEstimator

    env = StairClimbRgbdEnv(**{**kwargs, "stair_source": "external"})
    return PerceptionWrapper(env, StairEstimator(**(estimator or {})))
