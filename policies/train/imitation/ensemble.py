"""Several networks fitted anew to all advice of a run, averaged by one network.

Each fit ends somewhere else, and what they err in is partly its own: the mean of their actions is nearer to the teacher
than each of them. Side by side they are one wider network with blocks of zeros: the result is an ordinary policy.

`python -m policies.train.imitation.ensemble RUN --members 3 --output FOLDER`
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from policies.train import checkpoints
from policies.train.imitation import dagger
from policies.train.imitation.run_folder import CARD_FILE, FINAL_FOLDER, read_card, read_rounds
from stair_env.common.files import write_json

if TYPE_CHECKING:
    from stable_baselines3 import PPO
    from torch import nn


def fit_ensemble(
    run: Path | str,
    output: Path | str,
    members: int = 3,
    updates: int | None = None,
    on_member: Callable[[int, float], None] | None = None,
) -> dict[str, Any]:
    """Fit networks to the advice of a run's rounds, and write their mean.

    Args:
        run: folder of a finished run of `dagger.imitate`; its statistics are kept.
        output: folder for policy and card.
        members: how many networks.
        updates: gradient steps of each; None takes those of the run's last round.
        on_member: called with each one's number and `dagger.fit`'s error.

    Returns:
        The card.

    Raises:
        ValueError: members or updates is below 1.
        FileNotFoundError: the run is not finished.
    """
    config, final = dagger.load_config(run), Path(run) / FINAL_FOLDER
    updates = config.updates * config.final_factor if updates is None else updates
    if members < 1 or updates < 1:
        raise ValueError(f"members={members!r} and updates={updates!r} must be >= 1")
    card = read_card(run)
    venv = dagger.make_students_env(config, 1)
    try:
        trained = dagger.load_model(venv, final)
        lessons = [dagger.read_lesson(trained, samples) for samples in read_rounds(run)]
        fitted = []
        for member in range(members):
            model = dagger.new_model(dataclasses.replace(config, seed=config.seed + 1000 + member), venv)
            loss = dagger.fit(model, lessons, updates, config, np.random.default_rng([config.seed, 1000 + member]))
            fitted.append(model)
            if on_member:
                on_member(member, loss)
        widths = tuple(members * width for width in config.net_arch)
        merged = dagger.new_model(dataclasses.replace(config, net_arch=widths), venv)
        merge_actors(fitted, merged)
        merged.num_timesteps = trained.num_timesteps
        merged.get_vec_normalize_env().obs_rms = trained.get_vec_normalize_env().obs_rms  # type: ignore[union-attr]
        checkpoints.save_policy(merged, Path(output))
    finally:
        venv.close()
    card["hyperparams"] |= {"members": members, "member_updates": updates, "net_arch": list(widths)}
    write_json(Path(output) / CARD_FILE, card, seed=config.seed)
    return card


def merge_actors(members: Sequence[PPO], merged: PPO) -> None:
    """Have one actor return the mean of several.

    Args:
        members: models with the same layers.
        merged: model whose hidden layers are `len(members)` times as wide.
    """
    import torch

    with torch.no_grad():
        for depth, layer in enumerate(_layers(merged)):
            parts = [_layers(member)[depth] for member in members]
            if depth == 0:
                layer.weight.copy_(torch.cat([part.weight for part in parts]))
                layer.bias.copy_(torch.cat([part.bias for part in parts]))
            elif layer is _layers(merged)[-1]:
                layer.weight.copy_(torch.cat([part.weight for part in parts], dim=1) / len(parts))
                layer.bias.copy_(torch.stack([part.bias for part in parts]).mean(dim=0))
            else:
                layer.weight.copy_(torch.block_diag(*[part.weight for part in parts]))
                layer.bias.copy_(torch.cat([part.bias for part in parts]))


def _layers(model: PPO) -> list[nn.Linear]:
    """Linear layers of the actor, from the features to the action."""
    import torch

    policy: Any = model.policy
    hidden = [layer for layer in policy.mlp_extractor.policy_net if isinstance(layer, torch.nn.Linear)]
    return [*hidden, policy.action_net]


def _main() -> None:
    import argparse

    parser = argparse.ArgumentParser(
        prog="python -m policies.train.imitation.ensemble", description="Average networks fitted to a run's advice."
    )
    parser.add_argument("run", type=Path)
    parser.add_argument("--output", type=Path, required=True, help="folder of the policy")
    parser.add_argument("--members", type=int, default=3, help="how many networks (%(default)s)")
    parser.add_argument("--updates", type=int, help="gradient steps of each (those of the run's last round)")
    args = parser.parse_args()
    fit_ensemble(
        args.run,
        args.output,
        args.members,
        args.updates,
        on_member=lambda member, loss: print(f"member {member}: error {loss:.4f}", flush=True),
    )
    print(args.output)


if __name__ == "__main__":
    _main()
