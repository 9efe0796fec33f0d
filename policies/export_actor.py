"""Writes a trained policy for robots: ONNX and plain arrays, which `perception.deploy` reads without torch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from perception.deploy.onnx_actor import FORMAT, KEYS, MODEL, NOTE, STATISTICS
from policies.joint_level.remembering import remembers
from policies.pretrained import Policy, PolicyError, load
from stair_env.common.files import atomic_path

if TYPE_CHECKING:
    import torch

OPSET = 18


def export_actor(policy: Policy, folder: str | Path) -> Path:
    """Write the actor of a policy and its normalisation; each file appears whole or not at all.

    Args:
        policy: of PPO or SAC, on `proprio` and `stair`.
        folder: to write into; it is made.

    Returns:
        The folder.

    Raises:
        PolicyError: the policy reads other observations, or acts otherwise.
    """
    import torch

    from perception.inference.weights import strip_traces

    folder = Path(folder)
    spaces = getattr(policy.observation_space, "spaces", {})
    if not set(KEYS) <= set(spaces) or policy.action_space.shape is None:
        raise PolicyError(
            f"policy {policy.name!r} reads {', '.join(spaces) or 'one vector'}, must read {', '.join(KEYS)}"
        )
    sizes = {key: int(np.prod(space.shape)) for key, space in spaces.items()}
    if remembers(policy.observation_space) or policy.card.get("symmetric"):
        raise PolicyError(
            f"policy {policy.name!r} remembers or acts both ways, which the exported network alone would not"
        )
    actor = _actor_module(policy, sizes)
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_path(folder / MODEL) as temporary, torch.no_grad():
        torch.onnx.export(
            actor,
            tuple(torch.zeros(1, sizes[key]) for key in KEYS),
            str(temporary),
            input_names=list(KEYS),
            output_names=["action"],
            opset_version=OPSET,
            dynamo=True,
            external_data=False,
            verbose=False,
        )
        strip_traces(temporary)
    with atomic_path(folder / STATISTICS) as temporary, temporary.open("wb") as file:
        np.savez(file, **_statistics(policy))
    note = {
        "format": FORMAT,
        "name": policy.name,
        "robot": policy.card.get("env_kwargs", {}).get("robot", policy.card.get("robot", "")),
        "action_size": int(np.prod(policy.action_space.shape)),
        "proprio_size": sizes["proprio"],
        "card": {key: policy.card[key] for key in ("algorithm", "commit", "timesteps") if key in policy.card},
    }
    with atomic_path(folder / NOTE) as temporary:
        temporary.write_text(json.dumps(note, indent=2) + "\n", encoding="utf-8")
    return folder


def _statistics(policy: Policy) -> dict[str, Any]:
    """What VecNormalize had learned of the parts that it normalises."""
    learned: Any = policy.normalisation
    if learned is None or not learned.norm_obs:
        return {}
    found = {"epsilon": np.float64(learned.epsilon), "clip": np.float64(learned.clip_obs)}
    for key in set(KEYS) & set(learned.norm_obs_keys or KEYS):
        found[f"{key}_mean"], found[f"{key}_var"] = learned.obs_rms[key].mean, learned.obs_rms[key].var
    return {name: np.asarray(value) for name, value in found.items()}


def _actor_module(policy: Policy, sizes: dict[str, int]) -> torch.nn.Module:
    """(B, proprio) and (B, 8) to the most likely action (B, n); what is privileged is read as zeros."""
    import torch

    network: Any = policy.model.to("cpu").eval()
    rest = {key: size for key, size in sizes.items() if key not in KEYS}

    class _Actor(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.network = network

        def forward(self, proprio: torch.Tensor, stair: torch.Tensor) -> torch.Tensor:
            observation = {"proprio": proprio, "stair": stair}
            for key, size in rest.items():
                observation[key] = torch.zeros(proprio.shape[0], size)
            if hasattr(network, "actor") and not hasattr(network, "mlp_extractor"):
                action: torch.Tensor = network.actor(observation, deterministic=True)
                return action
            features = network.extract_features(observation, network.pi_features_extractor)
            mean: torch.Tensor = network.action_net(network.mlp_extractor.forward_actor(features))
            return mean

    return _Actor().eval()


def _main() -> None:
    """`python -m policies.export_actor NAME FOLDER` exports a policy."""
    import argparse

    parser = argparse.ArgumentParser(prog="python -m policies.export_actor", description=export_actor.__doc__)
    parser.add_argument("policy", help="a shipped name, or the folder of a run")
    parser.add_argument("folder", type=Path)
    args = parser.parse_args()
    print(export_actor(load(args.policy), args.folder))


if __name__ == "__main__":
    _main()
