"""How a network reads the observation: the stair block on a fixed scale, everything else as it comes.

`VecNormalize` suits the proprioception, but not the stair block: under a curriculum its statistics drift with the
level, and a constant tread depth would be blown up to noise. Importing this module loads torch.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np

from stair_env.common.importing.extras import naming_extras
from stair_env.observation import PRIVILEGED_KEY, STAIR_FIELDS, STAIR_KEY

with naming_extras():
    import torch
    from stable_baselines3.common.policies import MultiInputActorCriticPolicy
    from stable_baselines3.common.preprocessing import get_flattened_obs_dim
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from stable_baselines3.sac.policies import MultiInputPolicy as SacMultiInputPolicy
    from stable_baselines3.td3.policies import MultiInputPolicy as Td3MultiInputPolicy

# (middle, half span) of what each field takes on real stairs: treads 0.22-0.38 m, risers 0.05-0.19 m, an edge
# within a tread or so, a heading error of some 15 degrees, a measurement as old as a slow camera makes it.
STAIR_SCALE: dict[str, tuple[float, float]] = {
    "valid": (0.0, 1.0),
    "direction": (0.0, 1.0),
    "step_width": (0.30, 0.08),
    "step_height": (0.12, 0.07),
    "edge_distance": (0.15, 0.30),
    "heading_error": (0.0, 0.25),
    "age": (0.0, 0.50),
    "confidence": (0.0, 1.0),
}
# exp(-2.8) = 0.06 of residuals of 6 cm. In the classes, for searches replace `policy_kwargs` as a whole.
LOG_STD_INIT, SAC_LOG_STD_INIT = -2.8, -2.0
CLIP = 5.0  # scaled fields beyond this carry no more than "far"


class StairFeatures(BaseFeaturesExtractor):
    """Concatenates a Dict observation into one vector (B, n); the fields of `stair` are centred and scaled.

    An invalid block (valid = 0) stays all zero, which is not what scaling zeros would give.

    Attributes:
        hidden: keys in whose place zeros are read.
    """

    middle: torch.Tensor  # (8,)
    half_span: torch.Tensor  # (8,)

    def __init__(self, observation_space: gym.spaces.Dict) -> None:
        if not isinstance(observation_space, gym.spaces.Dict):
            raise ValueError(f"StairFeatures reads a Dict observation, got {observation_space}")
        super().__init__(observation_space, sum(map(get_flattened_obs_dim, observation_space.spaces.values())))
        scale = np.array([STAIR_SCALE[name] for name in STAIR_FIELDS], np.float32)
        self.keys = tuple(observation_space.spaces)
        self.hidden: tuple[str, ...] = ()
        self.register_buffer("middle", torch.as_tensor(scale[:, 0]), persistent=False)
        self.register_buffer("half_span", torch.as_tensor(scale[:, 1]), persistent=False)

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Dict of (B, ...) tensors to (B, features_dim)."""
        return torch.cat([self._read(key, observations[key]).flatten(1) for key in self.keys], dim=1)

    def _read(self, key: str, values: torch.Tensor) -> torch.Tensor:
        if key in self.hidden:
            return torch.zeros_like(values)
        return self._scaled(values) if key == STAIR_KEY else values

    def _scaled(self, stair: torch.Tensor) -> torch.Tensor:
        """(B, 8) stair block to scaled fields, zero where the block is invalid."""
        valid = (stair[:, :1] > 0.5).to(stair.dtype)
        return valid * ((stair - self.middle) / self.half_span).clamp(-CLIP, CLIP)


def hide_from_actor(extractor: Any) -> None:
    """Have an actor's feature extractor read zeros in place of the privileged block.

    Raises:
        ValueError: it is another than StairFeatures, which cannot.
    """
    if not isinstance(extractor, StairFeatures):
        raise ValueError("only StairFeatures can hide the privileged block from the actor")
    extractor.hidden = (PRIVILEGED_KEY,)


class StairActorCriticPolicy(MultiInputActorCriticPolicy):
    """PPO's multi-input policy reading through StairFeatures; a privileged block is for its critic alone.

    Args:
        log_std_init: as in SB3, but little exploration unless told: with more the gait falls before it learns.

    Raises:
        ValueError: there is a privileged block and features_extractor_class is another that cannot hide it.
    """

    def __init__(self, observation_space: gym.spaces.Dict, *args: Any, **kwargs: Any) -> None:
        kwargs.setdefault("features_extractor_class", StairFeatures)
        kwargs.setdefault("log_std_init", LOG_STD_INIT)
        asymmetric = PRIVILEGED_KEY in observation_space.spaces
        if asymmetric:
            kwargs["share_features_extractor"] = False
        super().__init__(observation_space, *args, **kwargs)
        if asymmetric:
            hide_from_actor(self.pi_features_extractor)


class ReadsStairs:
    """What policies of off-policy algorithms share: StairFeatures, and a privileged block for the critic alone."""

    def __init__(self, observation_space: gym.spaces.Dict, *args: Any, **kwargs: Any) -> None:
        kwargs["features_extractor_class"] = StairFeatures
        asymmetric = PRIVILEGED_KEY in observation_space.spaces
        if asymmetric:
            kwargs["share_features_extractor"] = False
        super().__init__(observation_space, *args, **kwargs)  # type: ignore[call-arg]
        if asymmetric:
            for actor in (self.actor, getattr(self, "actor_target", None)):  # type: ignore[attr-defined]
                if actor is not None:
                    hide_from_actor(actor.features_extractor)


class StairSacPolicy(ReadsStairs, SacMultiInputPolicy):
    """SAC's multi-input policy reading through StairFeatures; a privileged block is for its critic alone.

    Args:
        log_std_init: as in SB3, but little exploration unless told.
    """

    def __init__(self, observation_space: gym.spaces.Dict, *args: Any, **kwargs: Any) -> None:
        kwargs.setdefault("log_std_init", SAC_LOG_STD_INIT)
        super().__init__(observation_space, *args, **kwargs)


class StairTd3Policy(ReadsStairs, Td3MultiInputPolicy):
    """TD3's and DDPG's multi-input policy reading through StairFeatures; a privileged block is for its critic alone."""


def __getattr__(name: str) -> Any:
    """`StairTqcPolicy`, which needs sb3-contrib."""
    if name != "StairTqcPolicy":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from sb3_contrib.tqc.policies import MultiInputPolicy

    class StairTqcPolicy(ReadsStairs, MultiInputPolicy):
        """TQC's multi-input policy, as `StairSacPolicy`."""

        def __init__(self, observation_space: gym.spaces.Dict, *args: Any, **kwargs: Any) -> None:
            kwargs.setdefault("log_std_init", SAC_LOG_STD_INIT)
            super().__init__(observation_space, *args, **kwargs)

    StairTqcPolicy.__qualname__ = name  # pickles find it here
    globals()[name] = StairTqcPolicy
    return StairTqcPolicy
