"""`stair-env train`: learn to climb with PPO or SAC."""

from __future__ import annotations

import argparse
import dataclasses
import math
import os
from pathlib import Path
from typing import Any

from stair_env.common.constants import ALGORITHMS, EPISODE_DIRECTIONS, VEC_KINDS
from stair_env.common.progress import progress_bar
from stair_env.common.validation import from_mapping
from stair_env_cli.arguments import (
    add_common_arguments,
    add_engine_arguments,
    add_network_server_argument,
    add_physics_argument,
    json_object,
    limit_threads,
    physics_kwargs,
    positive_int,
    write_json,
)

ONLY_LOCAL = ("start_from", "tensorboard", "wandb", "rerun")  # options that RLlib's runs do not have


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Declare the options."""
    parser = subparsers.add_parser(
        "train",
        help="train a policy with Stable-Baselines3 or RLlib",
        description="Train a policy; checkpoints are written while it runs, and --resume goes on after a kill.",
    )
    parser.add_argument("--output", type=Path, default=Path("runs/train"), help="folder of the run (%(default)s)")
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on from the newest checkpoint in --output; of the other options only --timesteps counts then",
    )
    parser.add_argument("--algo", choices=ALGORITHMS, default="ppo", help="algorithm (%(default)s)")
    parser.add_argument("--env", default="stair_env/StairClimb-v0", help="environment id (%(default)s)")
    parser.add_argument("--robot", help="robot (the environment's default)")
    parser.add_argument(
        "--actuation", choices=("gait", "joint"), help="what actions are (the environment's default: gait)"
    )
    parser.add_argument(
        "--teacher",
        choices=("gait", "stance"),
        help="learn joint angles by DAgger from the gait, or from the gait in a wider and lower stance; --set then "
        "takes fields of policies.train.imitation.dagger.ImitationConfig, and --timesteps is rounded up to full rounds",
    )
    parser.add_argument(
        "--direction", choices=EPISODE_DIRECTIONS, default="both", help="walking direction (%(default)s)"
    )
    parser.add_argument("--source", help="where the stair block comes from: oracle, noisy, blind, shuffled")
    parser.add_argument(
        "--no-curriculum", action="store_true", help="train on the whole range of stairs from the start"
    )
    parser.add_argument(
        "--env-kwargs", type=json_object, default={}, metavar="JSON", help="further arguments of the environment"
    )
    add_physics_argument(parser)
    parser.add_argument("--timesteps", type=positive_int, help="environment steps in total (from the YAML file)")
    parser.add_argument("--num-envs", type=positive_int, help="parallel environments (from the YAML file)")
    parser.add_argument(
        "--vec",
        choices=VEC_KINDS,
        default="auto",
        help="a process each, one process for all, a process per core, or what suits the cores (%(default)s)",
    )
    parser.add_argument(
        "--hyperparams", metavar="FILE", help="YAML file in rl_zoo3's layout instead of the shipped one"
    )
    parser.add_argument("--set", type=json_object, default={}, metavar="JSON", help="hyperparameters to replace")
    parser.add_argument("--start-from", metavar="POLICY", help="begin with a shipped policy or a folder (fine-tuning)")
    parser.add_argument("--checkpoint-every", type=positive_int, default=50_000, help="environment steps (%(default)s)")
    parser.add_argument("--tensorboard", action="store_true", help="write TensorBoard logs into the run's folder")
    parser.add_argument(
        "--wandb", metavar="PROJECT", help="curves on Weights & Biases too (WANDB_MODE=offline: into the run's folder)"
    )
    parser.add_argument(
        "--rerun",
        action="store_true",
        help="with each checkpoint fly the policy up and down, into recordings for the Rerun viewer in flights/",
    )
    text = "Stable-Baselines3 here, or RLlib over a Ray cluster, which needs stair-env[ray] (%(default)s)"
    add_engine_arguments(parser, ("local", "rllib"), text)
    add_network_server_argument(parser)
    parser.add_argument(
        "--workers", type=positive_int, default=os.cpu_count() or 1, help="environment runners of rllib (%(default)s)"
    )
    parser.add_argument("--torch-threads", type=positive_int, default=1, help="threads of the updates (%(default)s)")
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Train, and print where the policy is."""
    limit_threads(1)
    from policies.train import training

    if args.teacher:
        if args.engine != "local":
            raise ValueError(f"--teacher is for --engine local, not {args.engine}")
        return _imitate(args)
    started = (args.output / training.CONFIG_FILE).exists()
    if args.resume and started:
        config = training.load_config(args.output)
        if args.timesteps:
            config = dataclasses.replace(config, total_timesteps=args.timesteps)
        print(f"resuming the run in {args.output} as its {training.CONFIG_FILE} says")
    else:
        config = _config(args)
    if config.engine == "rllib":
        card = _train_with_rllib(args, config)
    else:
        start_from = None
        if args.start_from:
            from policies.pretrained import locate

            start_from = locate(args.start_from)
        card = training.train(config, args.output, resume=args.resume, start_from=start_from, show_progress=True)
    if args.json:
        write_json(args.json, card, seed=config.seed)
    rate = card["training"].get("success_rate")
    climbed = f", {rate:.0%} of the last episodes climbed" if isinstance(rate, float) else ""
    print(f"{card['timesteps']} steps{climbed}; policy in {args.output / training.FINAL_FOLDER}")
    return 0


def _train_with_rllib(args: argparse.Namespace, config: Any) -> dict[str, Any]:
    unknown = [name for name in ONLY_LOCAL if getattr(args, name)]
    if unknown:
        raise ValueError(f"--{unknown[0].replace('_', '-')} is for --engine local, not rllib")
    from policies.train.rllib.rllib_training import train

    return train(config, args.output, resume=args.resume, show_progress=True)


def _imitate(args: argparse.Namespace) -> int:
    from policies.train.imitation import dagger
    from policies.train.imitation.run_folder import CONFIG_FILE, FINAL_FOLDER

    if args.resume and (args.output / CONFIG_FILE).exists():
        config = dagger.load_config(args.output)
    else:
        kwargs = {"actuation": "joint", "actuator": "position", "spawn": "floor", **_env_kwargs(args)}
        kwargs.pop("curriculum", None)  # the teacher climbs from the start
        given = {"num_envs": args.num_envs, **args.set} if args.num_envs else args.set
        config = from_mapping("--set", dagger.ImitationConfig, given)
        config = dataclasses.replace(config, env_kwargs=kwargs, teacher=args.teacher, seed=args.seed, vec_kind=args.vec)
    if args.timesteps:
        config = dataclasses.replace(config, rounds=math.ceil(args.timesteps / config.steps_per_round))
    with progress_bar(config.rounds, "train", unit="round") as bar:

        def show(row: dict[str, Any]) -> None:
            bar.set_postfix(loss=row["loss"], alone=f"{row['alone_successes']}/{row['alone_episodes']}", refresh=False)
            bar.update(row["round"] + 1 - bar.n)

        card = dagger.imitate(config, args.output, resume=args.resume, on_round=show)
    if args.json:
        write_json(args.json, card, seed=config.seed)
    alone = card["training"]["success_rate"]
    print(
        f"{card['timesteps']} steps, {alone:.0%} of the last flights alone climbed; policy in "
        f"{args.output / FINAL_FOLDER}"
    )
    return 0


def _config(args: argparse.Namespace) -> Any:
    from policies.train.training import TrainingConfig

    return TrainingConfig(
        algorithm=args.algo,
        env_id=args.env,
        env_kwargs=_env_kwargs(args),
        hyperparams=args.set,
        hyperparams_file=args.hyperparams,
        total_timesteps=args.timesteps,
        num_envs=args.num_envs,
        seed=args.seed,
        vec_kind=args.vec,
        checkpoint_every=args.checkpoint_every,
        tensorboard=args.tensorboard,
        wandb=args.wandb,
        torch_threads=args.torch_threads,
        rerun=args.rerun,
        engine=args.engine,
        workers=args.workers,
        ray_address=args.ray_address,
        network_server=args.network_server,
    )


def _env_kwargs(args: argparse.Namespace) -> dict[str, Any]:
    env_kwargs: dict[str, Any] = {"direction": args.direction}
    if args.robot:
        env_kwargs["robot"] = args.robot
    if args.actuation:
        env_kwargs["actuation"] = args.actuation
    if args.source:
        env_kwargs["stair_source"] = args.source
    if not args.no_curriculum:
        env_kwargs["curriculum"] = True
    return {**env_kwargs, **physics_kwargs(args)}
