"""Builders of what stands about where people live: people, plants, bins, bags, chairs, bicycles, pipes, cables."""

from __future__ import annotations

import itertools
import math

import numpy as np

from stair_env.scene.objects.palette import CLOTH, FOLIAGE, PANELLING, RUBBER, SKIN, VIVID
from stair_env.scene.objects.solid_parts import Builder, Extent, Part, bar, box, upright


def _person(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Someone who stands or walks along x; the trousers have the distractor's own look."""
    height = spec.size[2]
    stride = float(rng.choice([0.0, 0.0, 0.12])) * height
    hip, shoulder, hand = 0.5 * height, 0.8 * height, 0.45 * height
    top = int(rng.choice([CLOTH, VIVID]))
    parts = []
    for side in (-1.0, 1.0):
        foot = side * stride / 2
        y = side * 0.055 * height
        parts.append(bar((foot, y, 0.07), (0.0, y, hip), 0.042 * height))
        parts.append(box((foot - 0.08, y - 0.045, 0.0), (foot + 0.17, y + 0.045, 0.08), look=RUBBER))
        swing = -side * stride * 0.7 + float(rng.uniform(0.0, 0.1))
        parts.append(bar((0.0, 2.1 * y, shoulder), (swing, 2.4 * y, hand), 0.026 * height, "capsule", look=top))
    parts.append(bar((0.0, 0.0, hip), (0.02, 0.0, shoulder - 0.03), 0.085 * height, "capsule", look=top))
    parts.append(Part((0.03, 0.0, 0.925 * height), (0.065 * height, 0.0, 0.0), kind="sphere", look=SKIN))
    return parts


def _plant(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """A pot with a bush or with blades."""
    width, _, height = spec.size
    pot = float(rng.uniform(0.25, 0.45)) * height
    parts = [upright(0.0, 0.0, 0.0, pot, 0.3 * width)]
    bushy = rng.random() < 0.5
    for k in range(min(spec.count, 9)):
        turn = 2 * math.pi * (k + float(rng.uniform(-0.3, 0.3))) / min(spec.count, 9)
        if bushy:
            off = float(rng.uniform(0.0, 0.25)) * width
            z = float(rng.uniform(pot, 0.85 * height))
            radius = float(rng.uniform(0.12, 0.25)) * width
            parts.append(
                Part((off * math.cos(turn), off * math.sin(turn), z), (radius, 0.0, 0.0), kind="sphere", look=FOLIAGE)
            )
        else:
            lean = float(rng.uniform(0.15, 0.9))
            length = float(rng.uniform(0.7, 1.0)) * (height - pot)
            off = length / 2 * math.sin(lean)
            centre = (off * math.cos(turn), off * math.sin(turn), pot + length / 2 * math.cos(lean))
            size = (0.004, float(rng.uniform(0.04, 0.12)) * width, length / 2)
            parts.append(Part(centre, size, pitch=lean, yaw=turn, look=FOLIAGE))
    return parts


def _bin(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Round, or square on wheels with a lid."""
    depth, width, height = spec.size
    if rng.random() < 0.5:
        return [
            upright(0.0, 0.0, 0.0, 0.92 * height, depth / 2),
            upright(0.0, 0.0, 0.92 * height, height, 0.54 * depth, shift=1),
        ]
    half_x, half_y = depth / 2, width / 2
    wheels = [
        bar((half_x * 0.7, side * half_y, 0.08), (half_x * 0.7, side * (half_y - 0.05), 0.08), 0.08, look=RUBBER)
        for side in (-1.0, 1.0)
    ]
    lid = Part((0.0, 0.0, height - 0.03), (half_x * 1.08, half_y * 1.06, 0.03), pitch=0.08, look_shift=1)
    return [box((-half_x, -half_y, 0.04), (half_x, half_y, height - 0.06)), lid, *wheels]


def _bag(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """A suitcase or bag with a handle."""
    depth, width, height = spec.size
    body = 0.85 * height
    grip = [
        bar((0.0, side * width * 0.2, body), (0.0, side * width * 0.2, height), 0.008, look=RUBBER)
        for side in (-1.0, 1.0)
    ]
    across = bar((0.0, -width * 0.2, height - 0.01), (0.0, width * 0.2, height - 0.01), 0.01, look=RUBBER)
    return [box((-depth / 2, -width / 2, 0.0), (depth / 2, width / 2, body)), *grip, across]


def _chair(spec: Extent, rng: np.random.Generator) -> list[Part]:
    depth, width, height = spec.size
    seat = 0.5 * height
    legs = [
        upright(x * (depth / 2 - 0.02), y * (width / 2 - 0.02), 0.0, seat, 0.014, shift=1)
        for x in (-1.0, 1.0)
        for y in (-1.0, 1.0)
    ]
    back_from = seat + float(rng.uniform(0.0, 0.4)) * (height - seat)
    back = box((depth / 2 - 0.03, -width / 2, back_from), (depth / 2, width / 2, height))
    return [box((-depth / 2, -width / 2, seat), (depth / 2, width / 2, seat + 0.03)), back, *legs]


def _bicycle(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Two wheels of straight pieces, a frame, a handlebar; it stands along y."""
    _, length, height = spec.size
    radius, pieces = min(0.33 * height, 0.24 * length), 8
    parts: list[Part] = []
    hubs = [(0.0, side * (length / 2 - radius), radius) for side in (-1.0, 1.0)]
    for _, y, z in hubs:
        rim = [
            (0.0, y + radius * math.cos(a), max(z + radius * math.sin(a), 0.015))
            for a in np.linspace(0.0, 2 * math.pi, pieces + 1)
        ]
        parts.extend(bar(a, b, 0.014, look=RUBBER) for a, b in itertools.pairwise(rim))
    seat, crank, fork = (
        (0.0, -0.15 * length, 0.85 * height),
        (0.0, -0.05 * length, radius),
        (0.0, 0.2 * length, 0.85 * height),
    )
    for start, end in ((hubs[0], seat), (hubs[0], crank), (crank, seat), (crank, fork), (fork, hubs[1]), (seat, fork)):
        parts.append(bar(start, end, 0.015))
    parts.append(bar((-0.25, fork[1], height), (0.25, fork[1], height), 0.012, look=RUBBER))
    parts.append(box((-0.06, seat[1] - 0.1, seat[2]), (0.06, seat[1] + 0.12, seat[2] + 0.05), look=RUBBER))
    return parts


def _pipes(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """Pipes that rise along a wall, and one that crosses them."""
    depth, width, height = spec.size
    count = min(spec.count, 5)
    places = np.sort(rng.uniform(-width / 2, width / 2, count)).tolist()
    parts = [upright(0.0, y, 0.0, height, float(rng.uniform(0.015, depth / 2))) for y in places]
    z = float(rng.uniform(0.2, 0.9)) * height
    return [*parts, bar((-depth / 2, -width / 2, z), (-depth / 2, width / 2, z), float(rng.uniform(0.012, 0.03)))]


def _door_frame(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """A frame with a door in it, half open or closed, before a wall."""
    depth, width, height = spec.size
    post = 0.06
    frame = [
        box(
            (-depth / 2, side * (width / 2 - post / 2) - post / 2, 0.0),
            (depth / 2, side * (width / 2 - post / 2) + post / 2, height),
        )
        for side in (-1.0, 1.0)
    ]
    lintel = box((-depth / 2, -width / 2, height - post), (depth / 2, width / 2, height))
    inner = width - 2 * post
    turn = float(rng.choice([0.0, rng.uniform(0.2, 1.2)]))
    hinge = (0.0, -inner / 2)
    centre = (hinge[0] - inner / 2 * math.sin(turn), hinge[1] + inner / 2 * math.cos(turn), (height - post) / 2)
    leaf = Part(centre, (0.02, inner / 2, (height - post) / 2), yaw=turn, look=int(rng.choice([PANELLING, VIVID])))
    return [*frame, lintel, leaf]


def _cable(spec: Extent, rng: np.random.Generator) -> list[Part]:
    """A cable or hose that lies across y in bends."""
    length, width, _ = spec.size
    bends = np.linspace(-width / 2, width / 2, min(spec.count, 8) + 1).tolist()
    sway = np.cumsum(rng.normal(0.0, 0.12 * length, len(bends))).tolist()
    points = [(x, y, 0.008) for x, y in zip(sway, bends)]
    return [bar(a, b, 0.007, look=RUBBER) for a, b in itertools.pairwise(points)]


CLUTTER: dict[str, tuple[Builder, bool]] = {  # and whether it collides
    "person": (_person, True),
    "plant": (_plant, True),
    "bin": (_bin, True),
    "bag": (_bag, True),
    "chair": (_chair, True),
    "bicycle": (_bicycle, True),
    "pipes": (_pipes, True),
    "door_frame": (_door_frame, True),
    "cable": (_cable, False),
}
