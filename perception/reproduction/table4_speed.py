"""Table 4 of the paper: sizes and run times of the three widths, on this machine's processor.

All back ends of all widths take turns on the same frame in one process, because only ratios of work done in the same
minutes hold on a machine that does other things too.
"""

from __future__ import annotations

import contextlib
import statistics
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from perception.inference.backends import BackendError, TorchBackend, make_exported_backend
from perception.inference.preprocess import colour_input, depth_input
from perception.inference.weights import available_widths, export_onnx, load_network
from perception.network import StairNetV2, state_dict_megabytes
from stair_env.common.constants import IMAGE_SIZE

EAGER = "torch_eager"  # the network as trained, called as a notebook would
PAPER_MB = {1.0: 10.4, 0.5: 2.87, 0.25: 0.95}
PAPER_MS = {  # table 4, by platform
    "R9 5950X + RTX A4000": {1.0: 11.09, 0.5: 5.31, 0.25: 3.06},
    "i7 10750H + RTX 2060 Max-P": {1.0: 19.57, 0.5: 9.62, 0.25: 4.90},
}
NOTES = (
    "Milliseconds of one frame, from uint8 colour and metres to the two grids: the medians of rounds in which all back "
    "ends of all widths take turns. times_eager: how often each fits into torch as trained, the median over rounds.",
    "The paper's milliseconds are of graphics cards: compare the order of the widths, not the height.",
)

Run = Callable[[np.ndarray, np.ndarray], Any]


@dataclass(frozen=True)
class Candidate:
    """A network of one width behind one back end."""

    width: float
    backend: str
    run: Run


def speed_table(
    widths: Sequence[float],
    rounds: int,
    threads: int = 1,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> dict[str, Any]:
    """Measure.

    Args:
        widths: any of 1.0, 0.5 and 0.25; without trained weights a network with random ones is timed.
        rounds: of turns.
        threads: of every back end.
        progress: wraps the iteration over rounds, to show a bar.

    Returns:
        JSON-able: `rows`, one a width, with size, parameters, `ms` and `times_eager` by back end and the paper's
        figures; `notes`; `threads`. OpenVINO is left out where it is not installed.

    Raises:
        ValueError: rounds < 1, or no such width.
    """
    if rounds < 1:
        raise ValueError(f"rounds={rounds!r} must be >= 1")
    networks = {width: _network(width) for width in widths}
    with tempfile.TemporaryDirectory() as folder:
        candidates = [one for width in widths for one in _candidates(networks[width], Path(folder), threads)]
    seconds = _take_turns(candidates, rounds, threads, progress)
    missing = [f"{width:g}x" for width in widths if width not in available_widths()]
    notes = [*NOTES, *([f"Not trained, so timed with random weights: {', '.join(missing)}."] if missing else [])]
    rows = [_row(networks[width], {c.backend: seconds[c] for c in candidates if c.width == width}) for width in widths]
    return {"rows": rows, "notes": notes, "threads": threads, "rounds": rounds}


def _network(width: float) -> StairNetV2:
    if width in available_widths():
        return load_network(width)
    torch.manual_seed(0)
    return StairNetV2(width).eval()


def _candidates(network: StairNetV2, folder: Path, threads: int) -> Iterable[Candidate]:
    """Every back end that is installed, over one network."""
    width = network.width
    yield Candidate(width, EAGER, lambda rgb, depth: _run_eager(network, rgb, depth))
    yield Candidate(width, "torch", TorchBackend(network=network, threads=threads))
    path = folder / f"{width}.onnx"
    export_onnx(network, path)
    yield Candidate(width, "onnx", make_exported_backend("onnx", path, threads))
    with contextlib.suppress(BackendError):
        yield Candidate(width, "openvino", make_exported_backend("openvino", path, threads))


def _run_eager(network: StairNetV2, rgb: np.ndarray, depth_m: np.ndarray) -> None:
    with torch.no_grad():
        network(torch.from_numpy(colour_input(rgb)), torch.from_numpy(depth_input(depth_m)))


def _take_turns(
    candidates: Sequence[Candidate],
    rounds: int,
    threads: int,
    progress: Callable[[Iterable[int]], Iterable[int]],
) -> dict[Candidate, list[float]]:
    """Seconds of each candidate in each round; the first call of each is not counted."""
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (1, IMAGE_SIZE, IMAGE_SIZE, 3)).astype(np.uint8)
    depth_m = rng.uniform(0.5, 4.0, (1, IMAGE_SIZE, IMAGE_SIZE)).astype(np.float32)
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        for candidate in candidates:
            candidate.run(rgb, depth_m)
        seconds: dict[Candidate, list[float]] = {candidate: [] for candidate in candidates}
        for _ in progress(range(rounds)):
            for candidate in candidates:
                start = time.perf_counter()
                candidate.run(rgb, depth_m)
                seconds[candidate].append(time.perf_counter() - start)
    finally:
        torch.set_num_threads(before)
    return seconds


def _row(network: StairNetV2, seconds: dict[str, list[float]]) -> dict[str, Any]:
    eager = seconds[EAGER]
    faster = {name: statistics.median(e / s for e, s in zip(eager, own)) for name, own in seconds.items()}
    return {
        "model": "StairNetV2",
        "width": network.width,
        "parameters": sum(parameter.numel() for parameter in network.parameters()),
        "state_dict_mb": round(state_dict_megabytes(network), 2),
        "paper_mb": PAPER_MB[network.width],
        "ms": {name: round(1e3 * statistics.median(own), 1) for name, own in seconds.items()},
        "times_eager": {name: round(ratio, 2) for name, ratio in faster.items() if name != EAGER},
        "paper_ms": {platform: times[network.width] for platform, times in PAPER_MS.items()},
    }
