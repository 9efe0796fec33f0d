"""How large distractors are in life."""

from __future__ import annotations

import numpy as np

Range = tuple[float, float]

# Extent along x, y and z, metres, and how many repeated parts, both ends included.
SIZES: dict[str, tuple[Range, Range, Range, tuple[int, int]]] = {
    "mat": ((0.4, 0.8), (0.6, 1.2), (0.01, 0.01), (1, 1)),
    "shelf": ((0.25, 0.45), (0.7, 1.6), (0.8, 2.0), (3, 7)),
    "ramp": ((0.8, 2.5), (0.8, 1.5), (0.1, 0.7), (1, 1)),
    "fence": ((0.1, 0.1), (0.8, 2.2), (0.7, 1.4), (4, 10)),
    "blinds": ((0.1, 0.1), (0.7, 1.6), (0.8, 2.0), (8, 18)),
    "bench": ((0.3, 0.5), (0.9, 1.8), (0.35, 0.5), (1, 1)),
    "boxes": ((0.25, 0.6), (0.25, 0.6), (0.2, 0.5), (1, 4)),
    "column": ((0.2, 0.5), (0.3, 0.3), (2.0, 2.6), (1, 1)),
    "shutter": ((0.15, 0.15), (1.0, 2.6), (1.9, 2.5), (1, 1)),
    "bookcase": ((0.22, 0.35), (0.7, 1.4), (1.2, 2.1), (4, 6)),
    "radiator": ((0.08, 0.14), (0.5, 1.5), (0.5, 0.9), (6, 16)),
    "ladder": ((0.3, 1.2), (0.35, 0.5), (1.5, 2.5), (6, 10)),
    "kerb": ((0.6, 3.0), (2.0, 6.0), (0.08, 0.17), (2, 6)),
    "road_marking": ((1.5, 4.0), (1.5, 4.0), (0.01, 0.01), (2, 5)),
    "drain": ((0.12, 0.4), (0.6, 3.0), (0.01, 0.01), (1, 5)),
    "board_pile": ((0.3, 1.0), (0.8, 2.2), (0.1, 0.7), (3, 9)),
    "benches": ((1.5, 3.5), (1.2, 2.5), (0.4, 0.48), (2, 4)),
    "wall_panel": ((0.1, 0.1), (1.2, 3.0), (0.9, 2.0), (1, 4)),
    "striped_ramp": ((1.0, 2.5), (0.8, 1.5), (0.1, 0.5), (4, 10)),
    "floor_field": ((0.8, 3.0), (0.8, 3.0), (0.01, 0.01), (1, 1)),
    "person": ((0.5, 0.5), (0.5, 0.5), (1.5, 1.9), (1, 1)),
    "plant": ((0.3, 0.7), (0.3, 0.7), (0.4, 1.4), (5, 9)),
    "bin": ((0.3, 0.6), (0.3, 0.6), (0.4, 1.1), (1, 1)),
    "bag": ((0.15, 0.28), (0.3, 0.45), (0.35, 0.7), (1, 1)),
    "chair": ((0.4, 0.5), (0.4, 0.5), (0.75, 1.0), (1, 1)),
    "bicycle": ((0.5, 0.5), (1.5, 1.8), (0.95, 1.1), (1, 1)),
    "pipes": ((0.06, 0.14), (0.3, 1.2), (1.8, 2.6), (1, 4)),
    "door_frame": ((0.1, 0.2), (0.8, 1.0), (2.0, 2.1), (1, 1)),
    "cable": ((0.4, 1.0), (1.0, 3.0), (0.01, 0.01), (5, 8)),
}
# Painted rows: stripes a row, metres a stripe, extent along y.
ROWS: dict[str, tuple[tuple[int, int], Range, Range]] = {
    "crosswalk": ((3, 7), (0.35, 0.8), (1.2, 3.0)),
    "floor_stripes": ((1, 4), (0.25, 0.7), (1.0, 4.0)),
    "tile_seams": ((3, 9), (0.25, 0.6), (1.5, 4.0)),
    "planks": ((2, 7), (0.15, 0.4), (0.8, 2.0)),
}


def draw_size(rng: np.random.Generator, kind: str) -> tuple[tuple[float, float, float], int]:
    """Size along x, y, z in metres and count of a distractor."""
    if kind in ROWS:
        (least, most), each, across = ROWS[kind]
        count = int(rng.integers(least, most + 1))
        return (
            count * float(rng.uniform(*each)),
            float(rng.uniform(*across)),
            0.03 if kind == "planks" else 0.01,
        ), count
    x, y, z, (least, most) = SIZES[kind]
    count = int(rng.integers(least, most + 1))
    return (float(rng.uniform(*x)), float(rng.uniform(*y)), float(rng.uniform(*z))), count
