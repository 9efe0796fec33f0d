"""Learning curves on disk."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

CURVE_FILE = "curve.csv"
LOGGED = ("approx_kl", "explained_variance", "value_loss", "std", "ent_coef")  # SB3's names; each algorithm has some
CURVE_FIELDS = (
    "timesteps",
    "wall_s",
    "episodes",
    "return_mean",
    "length_mean",
    "success_rate",
    "level_mean",
    *LOGGED,
)


def read_curve(path: Path | str) -> list[dict[str, Any]]:
    """Rows of a learning curve, numbers as floats and missing values as ""; no file, no rows."""
    if not Path(path).is_file():
        return []
    with Path(path).open(newline="", encoding="utf-8") as file:
        return [
            {name: float(value) if value not in ("", None) else "" for name, value in row.items()}
            for row in csv.DictReader(file)
        ]
