"""`stair-env perception-train`: train StairNetV2 on a labelled set."""

from __future__ import annotations

import argparse
import dataclasses
import logging
from pathlib import Path
from typing import Any

from stair_env.common.constants import FUSION_STAGES, TRAINING_PRECISIONS, TRAINING_PRESETS
from stair_env_cli.arguments import (
    WIDTH_NAMES,
    add_common_arguments,
    limit_threads,
    non_negative_float,
    positive_float,
    positive_int,
    share,
    write_json,
)

ACCELERATORS = ("auto", "cpu", "gpu")
VALIDATION_FRAMES = 60  # after each epoch, in each of four conditions of depth


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Declare the options."""
    parser = subparsers.add_parser(
        "perception-train",
        help="train StairNetV2",
        description="Train StairNetV2 on a set that `stair-env dataset` wrote, or on the public one in the same "
        "folders. A checkpoint is written after every epoch; --resume goes on after a kill.",
    )
    parser.add_argument("--data", type=Path, required=True, help="folder with train and val")
    parser.add_argument("--output", type=Path, default=Path("runs/stairnetv2"), help="folder of the run (%(default)s)")
    parser.add_argument("--width", choices=WIDTH_NAMES, default="0.25", help="channel width factor (%(default)s)")
    parser.add_argument("--preset", choices=TRAINING_PRESETS, default="fast", help="schedule (%(default)s)")
    parser.add_argument("--epochs", type=positive_int, help="instead of the preset's")
    parser.add_argument("--frames-per-epoch", type=positive_int, help="instead of the preset's")
    parser.add_argument("--learning-rate", type=positive_float, help="largest, instead of the preset's")
    parser.add_argument("--precision", choices=TRAINING_PRECISIONS, help="float32 or bfloat16, instead of the preset's")
    parser.add_argument(
        "--small-share", type=share, metavar="SHARE", help="share of the epochs at half size, instead of the preset's"
    )
    parser.add_argument(
        "--drop-depth", type=share, metavar="SHARE", help="share of the frames without depth, instead of the preset's"
    )
    parser.add_argument(
        "--frozen-statistics", action="store_true", help="batch norms keep their mean and variance, for fine-tuning"
    )
    parser.add_argument(
        "--trust-weight",
        type=non_negative_float,
        metavar="WEIGHT",
        help="of the loss that draws the selective module to the modality that tells more, instead of the preset's",
    )
    parser.add_argument(
        "--fusion-stage", type=int, choices=FUSION_STAGES, default=2, help="down-samplings before fusion (%(default)s)"
    )
    parser.add_argument("--fixed-weights", action="store_true", help="equation 1 instead of dynamic loss weights")
    parser.add_argument(
        "--start-from",
        type=Path,
        metavar="FILE",
        help="begin with weights (safetensors), of a narrower network too: it is widened",
    )
    parser.add_argument("--resume", action="store_true", help="go on from the last checkpoint in --output")
    parser.add_argument("--workers", type=int, default=0, help="processes that read frames (%(default)s)")
    parser.add_argument("--threads", type=positive_int, help="threads of torch (all cores)")
    parser.add_argument(
        "--accelerator", choices=ACCELERATORS, default="auto", help="auto takes a graphics card if there is one"
    )
    parser.add_argument(
        "--devices", type=positive_int, default=1, help="graphics cards, or processes, that share a batch (%(default)s)"
    )
    parser.add_argument("--export", type=Path, metavar="DIR", help="folder for the weights (--output)")
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Train, export the weights, and print where they are."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    if args.threads:
        limit_threads(args.threads)
    import lightning
    import torch

    from perception.inference.weights import save_weights
    from perception.learning.frames import CONDITIONS, FrameModule
    from perception.learning.net2net import load_starting_point
    from perception.learning.network_training import StairNetTraining, train
    from perception.learning.presets import PRESETS
    from stair_env.common.files import provenance

    if args.threads:
        torch.set_num_threads(args.threads)
    lightning.seed_everything(args.seed, verbose=False)
    chosen: dict[str, Any] = {
        "epochs": args.epochs,
        "frames_per_epoch": args.frames_per_epoch,
        "learning_rate": args.learning_rate,
        "precision": args.precision,
        "small_share": args.small_share,
        "trust_weight": args.trust_weight,
    }
    chosen = {name: value for name, value in chosen.items() if value is not None}
    if args.fixed_weights:
        chosen["dynamic_weights"] = False
    if args.frozen_statistics:
        chosen["frozen_statistics"] = True
    if args.drop_depth is not None:
        augmentation = PRESETS[args.preset].augmentation
        chosen["augmentation"] = dataclasses.replace(augmentation, drop_depth=args.drop_depth)
    preset = dataclasses.replace(PRESETS[args.preset], **chosen)
    frames = FrameModule(
        args.data,
        preset,
        seed=args.seed,
        workers=args.workers,
        validation_frames=VALIDATION_FRAMES,
        conditions=CONDITIONS,
    )
    module = StairNetTraining(float(args.width), preset, args.fusion_stage)
    if args.start_from:
        source = load_starting_point(args.start_from, float(args.width), args.fusion_stage, args.seed)
        module.network.load_state_dict(source.state_dict())
    train(module, frames, args.output, resume=args.resume, accelerator=args.accelerator, devices=args.devices)
    if not module.trainer.is_global_zero:  # of several processes the first one writes
        return 0
    metrics = {name: round(float(value), 4) for name, value in module.trainer.callback_metrics.items()}
    card = {
        "model": "StairNetV2",
        "width": float(args.width),
        "fusion_stage": args.fusion_stage,
        "preset": args.preset,
        "training": dataclasses.asdict(preset),
        "devices": args.devices,
        "started_from": args.start_from.name if args.start_from else None,
        "data": str(args.data.name),
        "metrics": metrics,
        **provenance(args.seed),
    }
    paths = save_weights(module.network, args.export or args.output, card)
    if args.json:
        write_json(args.json, card, seed=args.seed)
    print(f"validation IOU {metrics.get('val/iou')} %; {', '.join(str(path) for path in paths)}")
    return 0
