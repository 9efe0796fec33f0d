"""What `gym.make` and `gym.make_vec` build for "stair_env/StairClimbPerception-v0"."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from perception.vector_wrapper import PerceptionVectorWrapper
from perception.wrapper import PerceptionWrapper
from stair_env.common.validation import SpecError
from stair_env.rgbd import StairClimbRgbdEnv
from stair_env.vector import WorkerVectorEnv, make_rgbd_vec


def make_perception_env(estimator: dict[str, Any] | None = None, **kwargs: Any) -> PerceptionWrapper:
    """The RGBD environment seen through StairNetV2.

    Args:
        estimator: keyword arguments of `StairEstimator`, for example {"width": 0.5, "backend": "torch"}.
        kwargs: see `StairClimbRgbdEnv`.

    Raises:
        SpecError: (a ValueError) an argument is wrong; the message names it, its value and the choices.
    """
    from perception.estimator import StairEstimator

    _check_source(kwargs)
    env = StairClimbRgbdEnv(**{**kwargs, "stair_source": "external"})
    return PerceptionWrapper(env, StairEstimator(**{"refine_gravity": False, **(estimator or {})}))


def make_perception_vec(
    num_envs: int = 1, estimator: dict[str, Any] | None = None, **kwargs: Any
) -> PerceptionVectorWrapper:
    """Many of them: worker processes walk and render, and here all frames go through the network in one batch.

    Args:
        num_envs: how many.
        estimator: as for `make_perception_env`; there is one estimator, in this process.
        kwargs: see `stair_env.vector.make_worker_vec`, those of each environment included.

    Raises:
        ValueError: an argument is wrong; the message names it, its value and the choices.
        WorkerError: the workers could not be started.
    """
    return perceive_vector(lambda own: make_rgbd_vec(num_envs, **own), {"estimator": estimator, **kwargs})


def perceive_vector(
    make_vector: Callable[[dict[str, Any]], WorkerVectorEnv], kwargs: Mapping[str, Any]
) -> PerceptionVectorWrapper:
    """Put the network before a vector of RGBD environments.

    Args:
        make_vector: builds it from the keyword arguments of `StairClimbRGBD-v0`.
        kwargs: keyword arguments of `StairClimbPerception-v0`.

    Raises:
        ValueError: an argument is wrong; the message names it, its value and the choices.
        WorkerError: the workers could not be started.
    """
    from perception.estimator import StairEstimator

    _check_source(kwargs)
    own = {name: value for name, value in kwargs.items() if name != "estimator"}
    vector = make_vector({**own, "stair_source": "external"})
    try:
        robot, intrinsics = vector.get_attr("robot")[0], vector.get_attr("camera_intrinsics")[0]
        return PerceptionVectorWrapper(
            vector, robot, intrinsics, StairEstimator(**{"refine_gravity": False, **(kwargs.get("estimator") or {})})
        )
    except BaseException:
        vector.close()
        raise


def _check_source(kwargs: Mapping[str, Any]) -> None:
    """Refuse a stair source that the camera would stand in for."""
    if kwargs.get("stair_source", "external") != "external":
        raise SpecError(
            f"stair_source={kwargs['stair_source']!r} must be 'external' (or left out): here the camera fills the "
            'stair block; other sources are for "stair_env/StairClimb-v0"'
        )
