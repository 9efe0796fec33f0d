"""What a graphics card makes of the network: run times by back end and batch beside the processor, a training step.

Table 4 of the paper was measured on graphics cards; `perception.reproduction.table4_speed` measures this machine's
processor. Where there is no card, the table has no rows and a sentence that says why.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from perception.inference.backends import Backend, BackendError, make_backend
from perception.learning.losses import GridTargets, LossWeights, detection_loss, total_loss
from perception.network import StairNetV2
from stair_env.common.constants import GPU_BACKENDS, GRID_COLUMNS, GRID_ROWS, IMAGE_SIZE

PROCESSOR = "onnx"  # what the cards are compared with
BATCHES = (1, 8, 32)
TRAINING_BATCH = 8
NOTE = (
    "Milliseconds of one frame, from uint8 colour and metres in memory to the two grids in memory: medians of rounds "
    "in which all back ends of a width take turns. off_processor: largest difference of a score from ONNX Runtime on "
    "the processor. training_ms: forward, backward and Adam's step in bfloat16, a frame."
)


@dataclass(frozen=True)
class Card:
    """A graphics card, or why there is none.

    Attributes:
        name: the card's; None without one.
        reason: why there is none, or "".
    """

    name: str | None
    reason: str


def find_card() -> Card:
    """The card that torch sees."""
    if torch.cuda.is_available():
        return Card(torch.cuda.get_device_name(0), "")
    built = "was built without CUDA" if torch.version.cuda is None else "finds no driver or no card"
    return Card(None, f"torch {torch.__version__} {built}")


def gpu_table(
    widths: Sequence[float],
    rounds: int,
    batches: Sequence[int] = BATCHES,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> dict[str, Any]:
    """Measure.

    Args:
        widths: any of 1.0, 0.5 and 0.25.
        rounds: of turns.
        batches: frames at once.
        progress: wraps the iteration over rounds, to show a bar.

    Returns:
        JSON-able: `card`, `rows` (width, batch, `ms` by back end, `off_processor` by back end, `training_ms`), `notes`.
        Back ends that cannot run here are named in `notes`.

    Raises:
        ValueError: rounds < 1 or a batch < 1.
    """
    if rounds < 1:
        raise ValueError(f"rounds={rounds!r} must be >= 1")
    if min(batches, default=0) < 1:
        raise ValueError(f"batches={tuple(batches)!r} must be whole numbers >= 1")
    card = find_card()
    if card.name is None:
        return {"card": None, "rows": [], "notes": [f"No graphics card, so nothing was measured: {card.reason}."]}
    rows, notes = [], [NOTE]
    for width in widths:
        backends, missing = _backends(width)
        notes += [note for note in missing if note not in notes]
        training_ms = _training_step_ms(width, rounds)
        rows += [{**row, "training_ms": training_ms} for row in turns(backends, width, batches, rounds, progress)]
    return {"card": card.name, "rows": rows, "notes": notes}


def _backends(width: float) -> tuple[dict[str, Backend], list[str]]:
    """Those that run here by name, the processor's among them, and a sentence for each that does not."""
    backends: dict[str, Backend] = {}
    missing: list[str] = []
    for name in (PROCESSOR, *GPU_BACKENDS):
        try:
            backends[name] = make_backend(name, width)
        except BackendError as error:
            missing.append(f"{name} left out: {error}.")
    return backends, missing


def turns(
    backends: dict[str, Backend],
    width: float,
    batches: Sequence[int],
    rounds: int,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> list[dict[str, Any]]:
    """A row for each batch size: back ends by turns on the same random frames; their first calls are not counted."""
    rng = np.random.default_rng(0)
    rows = []
    for batch in batches:
        rgb = rng.integers(0, 256, (batch, IMAGE_SIZE, IMAGE_SIZE, 3)).astype(np.uint8)
        depth_m = rng.uniform(0.5, 4.0, (batch, IMAGE_SIZE, IMAGE_SIZE)).astype(np.float32)
        answers = {name: backend(rgb, depth_m)[0] for name, backend in backends.items()}
        seconds: dict[str, list[float]] = {name: [] for name in backends}
        for _ in progress(range(rounds)):
            for name, backend in backends.items():
                start = time.perf_counter()
                backend(rgb, depth_m)
                seconds[name].append((time.perf_counter() - start) / batch)
        off = {name: float(np.abs(answer - answers[PROCESSOR]).max()) for name, answer in answers.items()}
        rows.append(
            {
                "width": width,
                "batch": batch,
                "ms": {name: round(1e3 * statistics.median(own), 3) for name, own in seconds.items()},
                "off_processor": {name: round(value, 6) for name, value in off.items() if name != PROCESSOR},
            }
        )
    return rows


def _training_step_ms(width: float, rounds: int) -> float:
    """Median over rounds, a frame."""
    network = StairNetV2(width).train().cuda()
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-4)
    rgb, depth = (torch.randn(TRAINING_BATCH, channels, IMAGE_SIZE, IMAGE_SIZE, device="cuda") for channels in (3, 1))
    grids = [torch.rand(TRAINING_BATCH, channels, GRID_ROWS, GRID_COLUMNS, device="cuda") for channels in (1, 8)]
    targets = GridTargets(grids[0].round(), grids[1])
    seconds = []
    for _ in range(rounds + 1):
        torch.cuda.synchronize()
        start = time.perf_counter()
        with torch.autocast("cuda", dtype=torch.bfloat16):
            raw = network.forward_raw(rgb, depth)
        raw = type(raw)(raw.cls_logits.float(), raw.loc.float())
        total_loss(detection_loss(raw, targets), LossWeights()).backward()
        optimiser.step()
        optimiser.zero_grad()
        torch.cuda.synchronize()
        seconds.append((time.perf_counter() - start) / TRAINING_BATCH)
    return round(1e3 * statistics.median(seconds[1:]), 3)
