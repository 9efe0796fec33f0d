"""Builders of further things whose parallel lines look like stairs: shutters, books, radiators, ladders, piles."""

from __future__ import annotations

import math

import numpy as np

from stair_env.scene.objects.palette import GRATING, PANELLING, SIDING, STONE, TILES, VIVID
from stair_env.scene.objects.solid_parts import PAINT_THICKNESS_M, Builder, Extent, Part, bar, box


def _shutter(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """A roller shutter between its rails, its drum above; a garage's is the wider."""
    _, width, height = spec.size
    rails = [
        box((-0.04, side * width / 2 - 0.03, 0.0), (0.03, side * width / 2 + 0.03, height), look_shift=1)
        for side in (-1.0, 1.0)
    ]
    drum = box((-0.12, -width / 2, height - 0.22), (0.03, width / 2, height), look_shift=1)
    gap = float(rng.choice([0.0, rng.uniform(0.0, 0.4)])) * height
    return [box((0.0, -width / 2, gap), (0.02, width / 2, height), look=SIDING), drum, *rails]


def _bookcase(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Boards between two cheeks, full of books."""
    depth, width, height = spec.size
    board = 0.012
    cheeks = [
        box((-depth / 2, side * width / 2 - board, 0.0), (depth / 2, side * width / 2 + board, height))
        for side in (-1.0, 1.0)
    ]
    levels = np.linspace(0.05, height - board, max(3, min(spec.count, 7))).tolist()
    parts = [box((-depth / 2, -width / 2, z - board), (depth / 2, width / 2, z + board)) for z in levels]
    room = levels[1] - levels[0] - 2 * board
    for z in levels[:-1]:
        y, shift = -width / 2 + 2 * board, int(rng.integers(4))
        while y < width / 2 - 0.15:
            thick = float(rng.uniform(0.05, 0.3)) * width  # a row of the same books
            end = min(y + thick, width / 2 - board)
            top = z + board + room * float(rng.uniform(0.5, 0.95))
            if rng.random() < 0.8:
                front = float(rng.uniform(0.2, 0.48)) * depth
                parts.append(box((-front, y, z + board), (depth / 2, end, top), look_shift=1 + shift % 5))
            y, shift = end + 0.01, shift + 1
    return [*cheeks, *parts]


def _radiator(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Ribs side by side, or tubes one above the other as in a bathroom."""
    depth, width, height = spec.size
    foot = 0.1
    if rng.random() < 0.5:
        radius = min(0.02, 0.35 * (height - foot) / spec.count)
        levels = np.linspace(foot + radius, height - radius, spec.count).tolist()
        tubes = [bar((0.0, -width / 2, z), (0.0, width / 2, z), radius) for z in levels]
        return [
            *tubes,
            *(box((-0.02, s * width / 2 - 0.02, 0.0), (0.02, s * width / 2 + 0.02, height)) for s in (-1, 1)),
        ]
    pitch = width / spec.count
    ribs = [
        box((-depth / 2, -width / 2 + (k + 0.15) * pitch, foot), (depth / 2, -width / 2 + (k + 0.85) * pitch, height))
        for k in range(spec.count)
    ]
    return [*ribs, bar((0.0, -width / 2, foot + 0.03), (0.0, width / 2, foot + 0.03), 0.02)]


def _ladder(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Two rails that lean along +x, and rungs."""
    length, width, height = spec.size
    foot, head = -length / 2, length / 2
    rails = [bar((foot, side * width / 2, 0.025), (head, side * width / 2, height), 0.022) for side in (-1.0, 1.0)]
    shares = (np.arange(spec.count) + 0.5) / spec.count
    rungs = [
        bar((foot + s * length, -width / 2, s * height), (foot + s * length, width / 2, s * height), 0.015)
        for s in shares.tolist()
    ]
    return [*rails, *rungs]


def _kerb(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Kerbstones with joints, and the pavement behind them."""
    length, width, height = spec.size
    count, stone = max(min(spec.count, 8), 1), float(rng.uniform(0.1, 0.2))
    pitch = width / count
    stones = [
        box(
            (-length / 2, -width / 2 + k * pitch, 0.0),
            (-length / 2 + stone, -width / 2 + (k + 1) * pitch - 0.008, height),
        )
        for k in range(count)
    ]
    behind = box(
        (-length / 2 + stone, -width / 2, 0.0),
        (length / 2 + stone, width / 2, height - 0.004),
        look=int(rng.choice([STONE, TILES])),
    )
    return [*stones, behind]


def _road_marking(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Dashes along x, and lines to stop at."""
    length, width, _ = spec.size
    period = length / spec.count
    line = float(rng.uniform(0.05, 0.08))
    dashes = [
        box((-length / 2 + k * period, -line, 0.0), (-length / 2 + (k + 0.5) * period, line, PAINT_THICKNESS_M))
        for k in range(spec.count)
    ]
    stops = [
        box((x, -width / 2, 0.0), (x + min(float(rng.uniform(0.08, 0.4)), 0.1 * length), width / 2, PAINT_THICKNESS_M))
        for x in (rng.uniform(-0.5, 0.4, int(rng.integers(1, 3))) * length).tolist()
    ]
    return dashes + stops


def _drain(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Gratings in a row across y, each in a frame."""
    length, width, _ = spec.size
    count = min(spec.count, 5)
    pitch = width / count
    frame = box((-length / 2 - 0.03, -width / 2 - 0.03, 0.0), (length / 2 + 0.03, width / 2 + 0.03, 0.001))
    fields = [
        box(
            (-length / 2, -width / 2 + k * pitch + 0.01, 0.0),
            (length / 2, -width / 2 + (k + 1) * pitch - 0.01, PAINT_THICKNESS_M),
            look=GRATING,
        )
        for k in range(count)
    ]
    return [frame, *fields]


def _board_pile(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Boards or slabs on top of each other, none quite flush; every third lies on battens."""
    length, width, height = spec.size
    thick = height / spec.count
    parts: list[Part] = []
    for k in range(spec.count):
        if k % 3 == 2 and spec.count < 10:  # battens: a dark gap
            parts.extend(
                box((-0.4 * length, y - 0.04, k * thick), (0.4 * length, y + 0.04, (k + 1) * thick), look_shift=1)
                for y in (-0.35 * width, 0.35 * width)
            )
            continue
        centre = (float(rng.normal(0.0, 0.02)), float(rng.normal(0.0, 0.03)), (k + 0.5) * thick)
        half = (length / 2 * float(rng.uniform(0.9, 1.0)), width / 2 * float(rng.uniform(0.9, 1.0)), 0.47 * thick)
        parts.append(Part(centre, half, yaw=float(rng.normal(0.0, 0.02)), look_shift=int(rng.random() < 0.2)))
    return parts


def _benches(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Rows of benches behind each other, all of one height: pews, a waiting room."""
    length, width, height = spec.size
    rows, seat = min(spec.count, 5), float(rng.uniform(0.25, 0.4))
    parts = []
    for x in (np.linspace(-length / 2, length / 2 - seat, rows) if rows > 1 else np.array([-seat / 2])).tolist():
        parts.append(box((x, -width / 2, height - 0.05), (x + seat, width / 2, height)))
        parts.extend(
            box((x + 0.04, y - 0.03, 0.0), (x + seat - 0.04, y + 0.03, height - 0.05), look_shift=1)
            for y in (-0.4 * width, 0.4 * width)
        )
    return parts


def _wall_panel(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """A stretch of wall clad with boards, fields or tiles, and rails across it."""
    _, width, height = spec.size
    cladding = int(rng.choice([SIDING, PANELLING, TILES, VIVID]))
    parts = [box((0.0, -width / 2, 0.0), (0.03, width / 2, height), look=cladding)]
    for z in (rng.uniform(0.1, 0.95, min(spec.count, 4)) * height).tolist():
        parts.append(box((-0.02, -width / 2, z), (0.0, width / 2, z + float(rng.uniform(0.02, 0.1)))))
    return parts


def _striped_ramp(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """An inclined slab with bars of paint or anti-slip tape across it."""
    length, width, height = spec.size
    thick, rise = 0.04, min(height, 0.6 * length)
    pitch = math.atan2(rise, length)
    along, normal = (math.cos(pitch), math.sin(pitch)), (-math.sin(pitch), math.cos(pitch))
    run = math.hypot(length, rise)

    def place(s: float, lift: float) -> tuple[float, float, float]:
        return (s * along[0] + lift * normal[0], 0.0, rise / 2 + s * along[1] + lift * normal[1])

    parts = [Part(place(0.0, -thick / 2), (run / 2, width / 2, thick / 2), pitch=-pitch)]
    period, half = run / spec.count, float(rng.uniform(0.01, 0.05))
    parts.extend(
        Part(place((k + 0.5) * period - run / 2, 0.001), (half, width / 2, 0.001), pitch=-pitch, look_shift=1)
        for k in range(spec.count)
    )
    return [*parts, box((length / 2, -width / 2, 0.0), (length / 2 + 0.6, width / 2, rise))]


def _floor_field(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Another covering let into the floor, with a border: tiles, boards, a grid of joints."""
    length, width, _ = spec.size
    rim = float(rng.uniform(0.03, 0.15))
    outer = box((-length / 2, -width / 2, 0.0), (length / 2, width / 2, 0.001), look_shift=1)
    inner = box(
        (-length / 2 + rim, -width / 2 + rim, 0.0), (length / 2 - rim, width / 2 - rim, PAINT_THICKNESS_M),
        look=int(rng.choice([TILES, STONE, SIDING, PANELLING])),
    )  # fmt: skip
    return [outer, inner] if min(length, width) > 2.5 * rim else [outer]


LOOK_ALIKES: dict[str, tuple[Builder, bool]] = {  # and whether it collides
    "shutter": (_shutter, True),
    "bookcase": (_bookcase, True),
    "radiator": (_radiator, True),
    "ladder": (_ladder, True),
    "kerb": (_kerb, True),
    "road_marking": (_road_marking, False),
    "drain": (_drain, False),
    "board_pile": (_board_pile, True),
    "benches": (_benches, True),
    "wall_panel": (_wall_panel, True),
    "striped_ramp": (_striped_ramp, True),
    "floor_field": (_floor_field, False),
}
