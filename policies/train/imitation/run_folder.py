"""What a run of learning from a teacher keeps on disk: rounds, curve and card."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from stair_env.common.files import atomic_path

CONFIG_FILE, CARD_FILE, CURVE_FILE = "config.json", "card.json", "curve.csv"
FINAL_FOLDER, CHECKPOINT_FOLDER, ROUND_FOLDER = "final", "checkpoints", "rounds"
ROUND_FILE = "round_{}.npz"

Samples = dict[str, np.ndarray]  # observation parts by key, and TEACHER_KEY: float32, a row a control step


def read_rounds(folder: Path | str, count: int | None = None) -> Iterator[Samples]:
    """Observations and advice of a run's first rounds, or of all."""
    files = sorted((Path(folder) / ROUND_FOLDER).glob(ROUND_FILE.format("*")))
    for path in files[:count]:
        with np.load(path) as stored:
            yield {key: stored[key] for key in stored.files}


def write_round(folder: Path, number: int, samples: Samples) -> None:
    """Keep what a round gave."""
    path = folder / ROUND_FOLDER / ROUND_FILE.format(f"{number:03d}")
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **samples)  # type: ignore[arg-type]


def write_curve(folder: Path, rows: list[dict[str, Any]]) -> None:
    """Write the curve, a row a round."""
    with atomic_path(folder / CURVE_FILE) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def read_curve(folder: Path) -> list[dict[str, Any]]:
    """Rows of the curve so far."""
    if not (folder / CURVE_FILE).exists():
        return []
    with (folder / CURVE_FILE).open(newline="", encoding="utf-8") as file:
        return [{name: json.loads(value) for name, value in row.items()} for row in csv.DictReader(file)]
