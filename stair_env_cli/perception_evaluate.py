"""`stair-env perception-evaluate`: accuracy, recall and IOU of a detector, as in table 5 of the paper."""

from __future__ import annotations

import argparse
import dataclasses
import functools
from pathlib import Path
from typing import Any

from stair_env.common.constants import DEPTH_SOURCES
from stair_env_cli.arguments import (
    WIDTH_NAMES,
    add_backend_argument,
    add_common_arguments,
    choice_list,
    limit_threads,
    positive_int,
    progress,
    seed_list,
    write_json,
)

SUITES = ("stairnetv2", "robust", "classical", "paper", "speed", "gpu")
WEIGHED_FRAMES = 64  # of the robust suite's figure
CLASSICAL_IMAGES = ("colour", "depth")


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Declare the options."""
    parser = subparsers.add_parser(
        "perception-evaluate",
        help="accuracy, recall and IOU of a detector",
        description="Score StairNetV2 cell by cell (equation 10, threshold 0.5) on a labelled set: all frames, "
        "by light, by direction, without stairs, with black colour, without depth. Without --data a test set is "
        "rendered first. --suite robust scores the frames with depth blurred, holed, constant, swapped and missing, "
        "and draws which modality counts then. --suite classical scores Gabor + Canny + Hough on the same frames, "
        "with parameters found by a random search on validation frames. --suite paper reproduces tables 2, 3 and 6 of "
        "the paper on --data: it trains in --runs what is not trained yet (StairNetV2 with each fusion stage and with "
        "fixed weights, StairNet, the region detector), goes on where it was killed, and writes table2.json, "
        "table3.json and table6.json, and a picture of what each method finds, into --results. --suite speed writes "
        "table4.json there: sizes and run times of each --width, all back ends by turns. --suite gpu writes "
        "gpu.json: a graphics card beside the processor; without a card it says so.",
    )
    parser.add_argument("--suite", choices=SUITES, default="stairnetv2", help="what is scored (%(default)s)")
    parser.add_argument("--data", type=Path, help="labelled set; rendered into --render-to when not given")
    parser.add_argument("--split", default="test", help="folder of the set to score (%(default)s)")
    parser.add_argument("--frames", type=positive_int, default=608, help="frames to render (%(default)s)")
    parser.add_argument(
        "--render-to", type=Path, default=Path("runs/perception-test"), help="where to render (%(default)s)"
    )
    parser.add_argument(
        "--width", type=choice_list(WIDTH_NAMES), default=("0.25",), help="width factors, comma-separated (0.25)"
    )
    parser.add_argument(
        "--weights", type=Path, metavar="FILE", help="safetensors or onnx file instead of the shipped ones"
    )
    add_backend_argument(parser)
    parser.add_argument(
        "--depth",
        choices=DEPTH_SOURCES,
        default="model",
        help="score on depth with modelled errors, or matched from infrared pairs (%(default)s)",
    )
    parser.add_argument("--figure", type=Path, metavar="PNG", help="robust suite: weights of the modalities")
    parser.add_argument(
        "--workers", type=positive_int, default=1, help="processes that render or read frames (%(default)s)"
    )
    paper = parser.add_argument_group("paper suite")
    paper.add_argument("--runs", type=Path, default=Path("runs/paper"), help="folder of the trainings (%(default)s)")
    paper.add_argument("--results", type=Path, default=Path("results"), help="folder for the tables (%(default)s)")
    paper.add_argument("--epochs", type=positive_int, help="of every training (20: about 20 core-minutes each)")
    paper.add_argument("--frames-per-epoch", type=positive_int, help="of every training (1000)")
    paper.add_argument("--seeds", type=seed_list, default=(0,), help="of the trainings, comma-separated (0)")
    paper.add_argument(
        "--close-seeds",
        type=seed_list,
        default=(0, 1, 2),
        help="of rows that come out less than a point of IOU apart (0,1,2)",
    )
    paper.add_argument("--trained-only", action="store_true", help="train nothing: tables of the rows that are trained")
    paper.add_argument("--threads", type=positive_int, help="threads of torch (all cores; speed suite: 1)")
    speed = parser.add_argument_group("speed and gpu suites")
    speed.add_argument("--rounds", type=positive_int, default=15, help="turns of each back end (%(default)s)")
    tuning = parser.add_argument_group("classical and paper suites")
    tuning.add_argument(
        "--images",
        type=choice_list(CLASSICAL_IMAGES),
        default=("colour",),
        help="what the lines are sought in: colour (as in the paper), depth, comma-separated (colour)",
    )
    tuning.add_argument("--tune-data", type=Path, metavar="DIR", help="labelled set to tune on; --data when not given")
    tuning.add_argument("--tune-split", default="val", help="folder of that set to tune on (%(default)s)")
    tuning.add_argument("--tune-frames", type=positive_int, default=200, help="frames to tune on (%(default)s)")
    tuning.add_argument("--trials", type=positive_int, default=120, help="candidates of the search (%(default)s)")
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Evaluate, and print the table."""
    suites = {
        "stairnetv2": _run_network,
        "robust": _run_robust,
        "classical": _run_classical,
        "paper": _run_paper,
        "speed": _run_speed,
        "gpu": _run_gpu,
    }
    return suites[args.suite](args)


def _run_network(args: argparse.Namespace) -> int:
    from perception.data.stair_dataset import StairDataset
    from perception.reproduction.table5_detection import as_rows, beside_paper, evaluate_detector

    backends = [(float(width), _backend(args, float(width))) for width in args.width]
    frames = StairDataset(_test_root(args), args.split or None, depth_folder=_depth_folder(args))
    rows: list[dict[str, Any]] = []
    for width, backend in backends:
        bar = functools.partial(progress, description=f"StairNetV2 {width:g}x")
        tallies = evaluate_detector(backend, frames, progress=bar)
        rows.extend(beside_paper(as_rows(tallies, "StairNetV2", width)))
    if args.json:
        write_json(args.json, {"rows": rows, "backend": args.backend, "depth": args.depth}, seed=args.seed)
    _print_table(rows)
    return 0


def _run_robust(args: argparse.Namespace) -> int:
    from perception.data.stair_dataset import StairDataset
    from perception.inference.weights import load_network, load_weights
    from perception.reproduction.corrupted_depth import (
        draw_colour_weights,
        look_at_selection,
        mean_weights,
        score_corrupted,
    )

    frames = StairDataset(_test_root(args), args.split or None)
    rows: list[dict[str, Any]] = []
    weights: dict[float, Any] = {}
    selection: list[dict[str, Any]] = []
    for width in map(float, args.width):
        bar = functools.partial(progress, description=f"StairNetV2 {width:g}x")
        rows.extend(score_corrupted(_backend(args, width), frames, width, bar))
        if args.figure and (args.weights is None or args.weights.suffix != ".onnx"):
            network = load_network(width) if args.weights is None else load_weights(args.weights, width)
            chosen = range(min(WEIGHED_FRAMES, len(frames)))
            weights[width], found = look_at_selection(network.eval(), frames, chosen)
            selection.extend({"width": width} | row for row in found)
    if args.json:
        report = {"rows": rows, "colour_weight": mean_weights(weights), "selection": selection}
        report["backend"] = args.backend
        write_json(args.json, report, seed=args.seed)
    if weights:
        from stair_env.common.files import atomic_path

        with atomic_path(args.figure) as temporary:
            draw_colour_weights(weights).savefig(temporary, dpi=110, format="png")
    _print_table([row for row in rows if row["lighting"] == "all"])
    return 0


def _run_classical(args: argparse.Namespace) -> int:
    from perception.data.stair_dataset import StairDataset
    from perception.reproduction.tables_2_3_6.classical_suite import evaluate_classical

    frames = StairDataset(_test_root(args), args.split or None)
    validation = StairDataset(_tuning_root(args), args.tune_split or None)
    report = evaluate_classical(
        validation,
        frames,
        seed=args.seed,
        tune_frames=args.tune_frames,
        trials=args.trials,
        progress=progress,
        images=args.images,
    )
    if args.json:
        write_json(args.json, report, seed=args.seed)
    _print_table(report["rows"])
    return 0


def _run_paper(args: argparse.Namespace) -> int:
    if args.data is None:
        raise ValueError(
            "--suite paper trains: --data must name a set with train, val and test (see stair-env dataset)"
        )
    if len(args.width) != 1:
        raise ValueError(f"--suite paper compares networks of one width, not of {', '.join(args.width)}")
    if args.threads:
        limit_threads(args.threads)
    import torch

    from perception.reproduction.tables_2_3_6.runs import SUITE_PRESET
    from perception.reproduction.tables_2_3_6.suite import PaperSuite, SuitePlan
    from stair_env_cli.contact_sheet import write_picture

    if args.threads:
        torch.set_num_threads(args.threads)
    chosen = {"epochs": args.epochs, "frames_per_epoch": args.frames_per_epoch}
    preset = dataclasses.replace(SUITE_PRESET, **{name: value for name, value in chosen.items() if value})
    workers = args.workers if args.workers > 1 else 0
    plan = SuitePlan(
        data=args.data,
        runs=args.runs,
        preset=preset,
        seeds=args.seeds,
        close_seeds=args.close_seeds,
        width=float(args.width[0]),
        tune_frames=args.tune_frames,
        trials=args.trials,
        workers=workers,
    )
    suite = PaperSuite(plan, progress)
    suite.measure(train=not args.trained_only)
    tables = suite.tables()
    for name, report in tables.items():
        write_json(args.results / f"{name}.json", report, seed=args.seed)
    if args.json:
        write_json(args.json, tables, seed=args.seed)
    write_picture(args.results / "table6.png", suite.picture())
    for name, report in tables.items():
        print(f"\n{name}")
        _print_table(report["rows"])
        print("\n".join(f"  {note}" for note in report["notes"]))
    return 0


def _run_speed(args: argparse.Namespace) -> int:
    threads = args.threads or 1
    limit_threads(threads)
    from perception.reproduction.table4_speed import speed_table

    bar = functools.partial(progress, description="speed")
    report = speed_table([float(width) for width in args.width], args.rounds, threads, bar)
    write_json(args.results / "table4.json", report, seed=args.seed)
    if args.json:
        write_json(args.json, report, seed=args.seed)
    for row in report["rows"]:
        times = ", ".join(f"{name} {value:.1f}" for name, value in row["ms"].items())
        ratios = ", ".join(f"{name} {value:.2f}" for name, value in row["times_eager"].items())
        size = f"{row['parameters']} parameters, {row['state_dict_mb']} MB (paper {row['paper_mb']})"
        print(f"{row['width']:g}x: {size}; ms a frame: {times}; times as fast as eager: {ratios}")
    print("\n".join(f"  {note}" for note in report["notes"]))
    return 0


def _run_gpu(args: argparse.Namespace) -> int:
    from perception.reproduction.gpu_speed import gpu_table

    bar = functools.partial(progress, description="gpu")
    report = gpu_table([float(width) for width in args.width], args.rounds, progress=bar)
    write_json(args.results / "gpu.json", report, seed=args.seed)
    if args.json:
        write_json(args.json, report, seed=args.seed)
    for row in report["rows"]:
        times = ", ".join(f"{name} {value:.2f}" for name, value in row["ms"].items())
        print(f"{row['width']:g}x, batches of {row['batch']}: ms a frame: {times}; training {row['training_ms']:.2f}")
    print("\n".join(f"  {note}" for note in report["notes"]))
    return 0


def _depth_folder(args: argparse.Namespace) -> str:
    from perception.data.stair_dataset import DEPTHS
    from perception.data.writer import stereo_folders

    return DEPTHS if args.depth == "model" else stereo_folders(1)[0]


def _test_root(args: argparse.Namespace) -> Path:
    return args.data if args.data is not None else _rendered(args, args.render_to, {"test": args.frames})


def _tuning_root(args: argparse.Namespace) -> Path:
    """Folder of the set to tune on; rendered beside the test set when there is none."""
    if args.tune_data is not None or args.data is not None:
        return args.tune_data if args.tune_data is not None else args.data
    folder = args.render_to.with_name(f"{args.render_to.name}-validation")
    return _rendered(args, folder, {"val": args.tune_frames})


def _backend(args: argparse.Namespace, width: float) -> Any:
    from perception.inference.backends import TorchBackend, make_backend, make_exported_backend
    from perception.inference.weights import load_weights

    if args.weights is None:
        return make_backend(args.backend, width)
    if args.weights.suffix == ".onnx":
        return make_exported_backend(args.backend, args.weights)
    return TorchBackend(network=load_weights(args.weights, width))


def _rendered(args: argparse.Namespace, root: Path, counts: dict[str, int]) -> Path:
    """Render a set, or complete one that is there; returns its folder."""
    from perception.data.synthetic import FrameConfig
    from perception.data.writer import DatasetPlan, complete, missing_frames, write_missing
    from stair_env.common.tasks import Engine

    matched = args.depth == "stereo" or args.suite == "robust"
    plan = DatasetPlan(root, counts, seed=args.seed, config=FrameConfig(stereo_variants=int(matched)))
    total = len(missing_frames(plan))
    for _ in progress(write_missing(plan, Engine(workers=args.workers)), total=total, description="rendering"):
        pass
    complete(plan)
    return root


def _print_table(rows: list[dict[str, Any]]) -> None:
    print(f"{'model':<37} {'width':>6} {'split':<14} {'accuracy':>9} {'recall':>8} {'IOU':>8} {'frames':>7}")
    for row in rows:
        found = f"   something found in {row['false_frames']} % of them" if "false_frames" in row else ""
        if "paper_iou" in row:
            found = "   paper " + " ".join(f"{row[f'paper_{name}']:.2f}" for name in ("accuracy", "recall", "iou"))
        if "cpu_ms" in row:
            found += f"   {row['cpu_ms']:.1f} ms"
        width = "" if row["width"] is None else f"{row['width']:g}"
        print(
            f"{row['model']:<37} {width:>6} {row['split']:<14} {row['accuracy']:>9.2f} {row['recall']:>8.2f} "
            f"{row['iou']:>8.2f} {row['frames']:>7}{found}"
        )
