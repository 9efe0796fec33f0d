"""RLlib's modules for Dict observations: the networks of `policies.features`, and the normalisation before them.

Parameters are those of Stable-Baselines3's policies, so that `policies.train.rllib.sb3_export` only has to rename them.
Importing this module loads RLlib and torch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from ray.rllib.algorithms.sac.torch.default_sac_torch_rl_module import DefaultSACTorchRLModule
from ray.rllib.core.columns import Columns
from ray.rllib.core.distribution.torch.torch_distribution import TorchSquashedGaussian
from ray.rllib.core.models.base import ENCODER_OUT
from ray.rllib.core.rl_module.apis.value_function_api import ValueFunctionAPI
from ray.rllib.core.rl_module.torch.torch_rl_module import TorchRLModule
from stable_baselines3.common.torch_layers import create_mlp

from policies.features import StairActorCriticPolicy, StairFeatures, hide_from_actor
from stair_env.observation import PRIVILEGED_KEY

CLIP_OBS, EPSILON = 10.0, 1e-8  # of SB3's VecNormalize
Observations = Mapping[str, torch.Tensor]
Statistics = Mapping[str, tuple[np.ndarray, np.ndarray]]  # key -> mean and variance


class Normaliser(torch.nn.Module):
    """What VecNormalize does to observations, with statistics that are set from outside.

    Args:
        space: of the observations.
        keys: that are normalised; the others pass as they are.
        clip_obs: normalised values are clipped to plus and minus this.
    """

    def __init__(self, space: gym.spaces.Dict, keys: Sequence[str], clip_obs: float = CLIP_OBS) -> None:
        super().__init__()
        self.keys, self.clip_obs = tuple(keys), clip_obs
        for key in self.keys:
            shape = space[key].shape or ()
            self.register_buffer(f"{key}_mean", torch.zeros(shape))
            self.register_buffer(f"{key}_var", torch.ones(shape))

    def forward(self, observations: Observations) -> dict[str, torch.Tensor]:
        """Dict of (B, ...) tensors to the same, float32."""
        return {key: self._scaled(key, values.float()) for key, values in observations.items()}

    def _scaled(self, key: str, values: torch.Tensor) -> torch.Tensor:
        if key not in self.keys:
            return values
        mean, var = getattr(self, f"{key}_mean"), getattr(self, f"{key}_var")
        return ((values - mean) / torch.sqrt(var + EPSILON)).clamp(-self.clip_obs, self.clip_obs)

    @torch.no_grad()
    def set_statistics(self, statistics: Statistics) -> None:
        """Take over means and variances."""
        for key in self.keys:
            mean, var = statistics[key]
            getattr(self, f"{key}_mean").copy_(torch.as_tensor(mean, dtype=torch.float32))
            getattr(self, f"{key}_var").copy_(torch.as_tensor(var, dtype=torch.float32))


class StairPpoModule(TorchRLModule, ValueFunctionAPI):
    """`StairActorCriticPolicy` as it is, behind a Normaliser.

    `model_config` holds `policy_kwargs` as SB3 takes them, `normalised` (keys) and `clip_obs`.
    """

    def setup(self) -> None:
        """Build the networks."""
        config = self.model_config
        space: Any = self.observation_space
        self.normaliser = Normaliser(space, config["normalised"], config["clip_obs"])
        self.policy = StairActorCriticPolicy(space, self.action_space, _no_learning, **config["policy_kwargs"])
        del self.policy.optimizer  # RLlib brings its own

    def _forward(self, batch: dict[str, Any], **kwargs: Any) -> dict[str, Any]:
        policy = self.policy
        features = policy.pi_features_extractor(self.normaliser(batch[Columns.OBS]))
        mean = policy.action_net(policy.mlp_extractor.forward_actor(features))
        return {Columns.ACTION_DIST_INPUTS: torch.cat([mean, policy.log_std.expand_as(mean)], dim=-1)}

    def compute_values(self, batch: dict[str, Any], embeddings: Any = None) -> torch.Tensor:
        """(B,) values of the observations."""
        policy = self.policy
        features = policy.vf_features_extractor(self.normaliser(batch[Columns.OBS]))
        values: torch.Tensor = policy.value_net(policy.mlp_extractor.forward_critic(features))
        return values.squeeze(-1)


class Trunk(torch.nn.Module):
    """Hidden layers on the features of an observation, and of an action with a critic.

    Args:
        space: of the observations.
        num_actions: width of the action that is read too; 0 for an actor.
        net_arch: widths of the hidden layers.
    """

    def __init__(self, space: gym.spaces.Dict, num_actions: int, net_arch: Sequence[int]) -> None:
        super().__init__()
        self.features = StairFeatures(space)
        if not num_actions and PRIVILEGED_KEY in space.spaces:
            hide_from_actor(self.features)
        self.reads_actions = num_actions > 0
        self.layers = torch.nn.Sequential(*create_mlp(self.features.features_dim + num_actions, -1, list(net_arch)))

    def forward(self, batch: Mapping[str, Any]) -> dict[str, torch.Tensor]:
        """Normalised observations (and actions) to the last hidden layer."""
        inputs = self.features(batch[Columns.OBS])
        if self.reads_actions:
            inputs = torch.cat([inputs, batch[Columns.ACTIONS]], dim=-1)
        return {ENCODER_OUT: self.layers(inputs)}


class GaussianHead(torch.nn.Module):
    """Mean and logarithm of the deviation, each a layer, as in SB3's SAC."""

    def __init__(self, width: int, num_actions: int) -> None:
        super().__init__()
        self.mu, self.log_std = torch.nn.Linear(width, num_actions), torch.nn.Linear(width, num_actions)

    def forward(self, latent: torch.Tensor) -> torch.Tensor:
        """(B, width) to (B, 2 * num_actions)."""
        return torch.cat([self.mu(latent), self.log_std(latent)], dim=-1)


class _SquashedActions:
    """In the place of a catalog, which knows no Dict observations: the distribution of actions."""

    def __init__(self, *, action_space: gym.spaces.Box, **kwargs: Any) -> None:
        self._space = action_space

    def get_action_dist_cls(self, framework: str) -> Any:
        """A Gaussian squashed into the bounds of the action."""
        bounds = {"low": float(self._space.low.min()), "high": float(self._space.high.max())}
        return TorchSquashedGaussian.get_partial_dist_cls(**bounds)


class StairSacModule(DefaultSACTorchRLModule):
    """The networks of `StairSacPolicy` behind a Normaliser.

    `model_config` holds `net_arch` {"pi": widths, "qf": widths}, `normalised` (keys) and `clip_obs`.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **{**kwargs, "catalog_class": _SquashedActions})

    def setup(self) -> None:
        """Build actor, twin critics and what the learner expects under RLlib's names."""
        config = self.model_config
        space: Any = self.observation_space
        actions, arch = int(np.prod(self.action_space.shape)), config["net_arch"]
        self.twin_q = True
        self.normaliser = Normaliser(space, config["normalised"], config["clip_obs"])
        self.pi_encoder, self.pi = Trunk(space, 0, arch["pi"]), GaussianHead(arch["pi"][-1], actions)
        if self.inference_only:
            return
        self.qf_encoder, self.qf = Trunk(space, actions, arch["qf"]), torch.nn.Linear(arch["qf"][-1], 1)
        self.qf_twin_encoder, self.qf_twin = Trunk(space, actions, arch["qf"]), torch.nn.Linear(arch["qf"][-1], 1)

    def _forward_inference(self, batch: dict[str, Any]) -> dict[str, Any]:
        return super()._forward_inference(self._normalised(batch))

    def _forward_train(self, batch: dict[str, Any]) -> dict[str, Any]:
        return super()._forward_train(self._normalised(batch))

    def _normalised(self, batch: Mapping[str, Any]) -> dict[str, Any]:
        keys = [key for key in (Columns.OBS, Columns.NEXT_OBS) if key in batch]
        return {**batch, **{key: self.normaliser(batch[key]) for key in keys}}

    def _qf_forward_train_helper(
        self, batch: dict[str, Any], encoder: Any, head: Any, squeeze: bool = True
    ) -> torch.Tensor:
        values: torch.Tensor = head(encoder(batch)[ENCODER_OUT])
        return values.squeeze(-1) if squeeze else values


def _no_learning(progress: float) -> float:
    return 0.0
