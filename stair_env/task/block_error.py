"""How far a stair block is from the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from stair_env.observation import STAIR_FIELDS

COMPARED_FIELDS = ("step_width", "step_height", "edge_distance")


class BlockError(NamedTuple):
    """Differences of a measured block from the true one, metres.

    Attributes:
        step_width, step_height, edge_distance: measured minus true.
        same_edge: both speak of the same next edge, that is, their distances to it differ by less than half a tread.
            Whoever passes an edge a moment late is a whole tread off until then, which says nothing about distances.
    """

    step_width: float
    step_height: float
    edge_distance: float
    same_edge: bool


def block_error(block: Sequence[float], truth: Mapping[str, Any]) -> BlockError | None:
    """Compare a stair block with the truth.

    Args:
        block: (8,) in the order of STAIR_FIELDS.
        truth: `info["truth"]`.

    Returns:
        None where the block claims no stairs.
    """
    measured = dict(zip(STAIR_FIELDS, map(float, block)))
    if measured["valid"] < 0.5:
        return None
    width, height, distance = (measured[name] - truth[name] for name in COMPARED_FIELDS)
    return BlockError(width, height, distance, bool(abs(distance) < truth["step_width"] / 2))
