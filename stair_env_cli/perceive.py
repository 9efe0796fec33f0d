"""`stair-env perceive`: measure stairs in what a camera sees, a recording holds, or files show."""

from __future__ import annotations

import argparse
import contextlib
import itertools
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stair_env.common.constants import GEOMETRY_METHODS, NETWORK_WIDTHS
from stair_env_cli.arguments import add_backend_argument, add_common_arguments, write_json
from stair_env_cli.source_arguments import AUTO, add_source_arguments, open_from

if TYPE_CHECKING:
    from perception.estimator import StairEstimator
    from perception.looking.frame_measurement import Measurement
    from perception.sources.preparation import SourceFrame

EXIT_INCOMPLETE = 2  # the source broke off, or what it calls depth is none; what was read is in the results


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "perceive",
        help="measure stairs in RGB-D images, a recording, or what a RealSense sees",
        description="Find stair lines, cluster them, measure the steps, and draw what was found. Without depth only "
        "lines are found. A NAME.json beside an image (intrinsics, gravity, depth_scale) overrides the options.",
    )
    add_source_arguments(parser)
    parser.add_argument("--width", type=float, choices=NETWORK_WIDTHS, default=0.25, help="of StairNetV2 (%(default)s)")
    add_backend_argument(parser)
    parser.add_argument("--method", choices=GEOMETRY_METHODS, default="planes", help="geometry (%(default)s)")
    parser.add_argument(
        "--record", type=Path, metavar="FILE", help="write the frames as .bag, .db3, .mcap, or a folder (no ending)"
    )
    parser.add_argument("--rerun", type=Path, metavar="FILE", help="write a recording for the Rerun viewer (.rrd)")
    parser.add_argument("--output", type=Path, default=Path("perceived"), help="folder for pictures (%(default)s)")
    parser.add_argument("--no-pictures", action="store_true", help="write no annotated images")
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Measure every frame; print one line each, write pictures and JSON."""
    from perception.drawing import draw_report
    from perception.estimator import StairEstimator
    from perception.sources.source import SourceError

    source, preparation = open_from(args)
    entries: list[dict[str, Any]] = []
    failure: Exception | None = None
    try:
        estimator = StairEstimator(args.width, args.backend, method=args.method)
        with _outputs(args) as outputs:
            for measured, seconds in _measured(args, source, preparation, estimator):
                entry = measured.to_dict()
                if not args.no_pictures:
                    picture = draw_report(measured.frame.rgb, measured.estimate, measured.grid)
                    entry["picture"] = str(_write_picture(args.output, measured.frame.name, picture))
                for output in outputs:
                    output(measured)
                entries.append(entry)
                _print(measured, seconds)
                failure = failure or _no_depth_file(measured.frame)
    except SourceError as error:
        failure = error
    finally:
        source.close()
    if args.json is not None:
        error_text = {} if failure is None else {"error": str(failure)}
        write_json(args.json, {"source": source.name, "frames": entries, **error_text}, seed=args.seed)
    if failure is not None:
        if not entries:
            raise failure
        print(f"stair-env perceive: error: {failure}", file=sys.stderr)
        return EXIT_INCOMPLETE
    if not entries:
        raise ValueError(f"{source.name}: holds no frame")
    return 0


def _measured(
    args: argparse.Namespace, source: Any, preparation: Any, estimator: StairEstimator
) -> Iterator[tuple[Measurement, tuple[float, float]]]:
    """Each frame's measurement, with the seconds it took and since the one before was there."""
    from perception.looking.frame_measurement import measure_frame
    from perception.sources.preparation import prepared

    last = time.perf_counter()
    scale = _GreyScale(estimator) if args.grey_level == AUTO else None
    for frame in itertools.islice(prepared(source, preparation), args.frames):
        start = time.perf_counter()
        measured = measure_frame(estimator, frame if scale is None else scale.apply(frame))
        now = time.perf_counter()
        yield measured, (now - start, now - last)
        last = now


def _no_depth_file(frame: SourceFrame) -> Exception | None:
    """The error of a frame whose depth file is no depth: who gave one did not ask for lines alone."""
    from perception.data.stair_dataset import DatasetError
    from perception.sources.hints import NO_DEPTH_ADVICE, NO_DEPTH_FILE

    told = [hint for hint in frame.hints if hint in NO_DEPTH_FILE]
    return DatasetError(f"{frame.files[-1]}: {told[0]}; {NO_DEPTH_ADVICE}") if told else None


class _GreyScale:
    """Puts 8-bit depth on the scale that the stairs in the first good frame suggest."""

    def __init__(self, estimator: StairEstimator) -> None:
        self._estimator, self._factor = estimator, 0.0

    def apply(self, frame: SourceFrame) -> SourceFrame:
        import dataclasses

        import numpy as np

        from perception.data.stair_dataset import GREY_LEVEL_M
        from perception.looking.grey_scale import estimate_grey_level
        from perception.sources.hints import GREY_DEPTH
        from stair_env.common.constants import LEVEL_CAMERA_GRAVITY

        if GREY_DEPTH not in frame.hints or frame.depth_m is None:
            return frame
        if not self._factor:
            levels = np.rint(frame.depth_m / GREY_LEVEL_M).astype(np.uint8)
            gravity = frame.gravity if frame.gravity is not None else np.array(LEVEL_CAMERA_GRAVITY)
            found = estimate_grey_level(frame.rgb, levels, frame.intrinsics, gravity, self._estimator)
            if found is None:
                return frame
            self._factor = found[0] / GREY_LEVEL_M
            print(f"8-bit depth: {1000 * found[0]:.2f} ± {1000 * found[1]:.2f} mm a level, from the steps in view")
        level = 1000 * self._factor * GREY_LEVEL_M
        said = f"depth-8-bit: {level:.2f} mm a level, estimated from the rule for steps; sizes carry its 5 %"
        hints = tuple(said if hint == GREY_DEPTH else hint for hint in frame.hints)
        return dataclasses.replace(frame, depth_m=frame.depth_m * np.float32(self._factor), hints=hints)


@contextlib.contextmanager
def _outputs(args: argparse.Namespace) -> Iterator[list[Any]]:
    """What each measurement is given to beside the results."""
    with contextlib.ExitStack() as stack:
        outputs: list[Any] = []
        if args.record is not None:
            from perception.sources.recording import recording

            recorder = stack.enter_context(recording(args.record))
            outputs.append(lambda measured: recorder.add(measured.frame))
        if args.rerun is not None:
            from perception.looking.rerun_log import rerun_log

            outputs.append(stack.enter_context(rerun_log(args.rerun)).add)
        yield outputs


def _write_picture(folder: Path, name: str, image: Any) -> Path:
    from stair_env.common.images import write_image

    path = folder / f"{name}_stairs.png"
    write_image(path, image[:, :, ::-1])
    return path


def _print(measured: Measurement, seconds: tuple[float, float]) -> None:
    """A line a frame: what was found, how long it took, and how many come a second."""
    estimate, (latency, between) = measured.estimate, seconds
    sizes = "  ".join(f"{1000 * step.width_m:.0f}x{1000 * step.height_m:.0f}" for step in estimate.steps)
    found = f"{estimate.direction_name}, {len(estimate.lines)} lines, width x height in mm: {sizes or '-'}"
    if not estimate.valid:
        found = f"no stairs measured: {estimate.reason} ({len(estimate.lines)} lines)"
    gravity = "" if measured.gravity_source in ("given", "imu") else f"  [gravity: {measured.gravity_source}]"
    timing = f"{1000 * latency:.0f} ms, {1.0 / max(between, 1e-6):.1f} a second"
    print(f"{measured.frame.name}: {found}{gravity}  ({timing})")
    for hint in measured.frame.hints:
        print(f"  hint: {hint}")
