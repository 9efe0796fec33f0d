"""What a policy sees: two blocks with documented order and finite bounds.

Everything in them can come from a real robot's sensors. Heights and distances are metres, angles radians.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from gymnasium import spaces

STAIR_FIELDS = (
    "valid",  # 1 while stairs are known, else 0 and every other field 0
    "direction",  # +1 ascending, -1 descending
    "step_width",  # tread depth of the next step
    "step_height",  # riser height of the next step, positive both ways
    "edge_distance",  # along the walking direction, from the midpoint of the front hips to the next nosing
    "heading_error",  # yaw of the stairs' walking direction seen from the base; positive: turn left
    "age",  # seconds since the measurement
    "confidence",  # 0..1
)
STAIR_KEY = "stair"  # of the observation
PRIVILEGED_KEY = "privileged"  # of the observation: see `stair_env.task.privileged`
STAIR_LOW = np.array([0, -1, 0, 0, -1, -math.pi / 2, 0, 0], np.float32)
STAIR_HIGH = np.array([1, 1, 1, 0.5, 5, math.pi / 2, 5, 1], np.float32)

PROPRIO_FIELDS: dict[str, tuple[int, float]] = {  # name: (length, bound)
    "gravity": (3, 1.0),  # unit vector that points down, base frame, from the fused attitude
    "angular_velocity": (3, 20.0),  # gyro, base frame, rad/s
    "velocity": (3, 5.0),  # leg odometry over the last control step, level frame that turns with the base, m/s
    "yaw_rate": (1, 20.0),  # heading change over the last control step, rad/s
    "joint_position": (12, 2 * math.pi),
    "joint_velocity": (12, 60.0),
    "joint_error": (12, 2 * math.pi),  # target - position: what the motors are asked beyond what they reach
    "contact": (4, 1.0),
    "foothold_height": (4, 1.0),  # where the gait wants each foot to stand, relative to the base's mean foothold
    "phase": (2, 1.0),  # sine and cosine of the gait's cycle
    "last_action": (16, 1.0),  # twelve with actuation="joint"
}


def name_slices(lengths: Mapping[str, int]) -> dict[str, slice]:
    """Return where each named part of a flat vector lies, from the parts' lengths in order."""
    found, start = {}, 0
    for name, length in lengths.items():
        found[name] = slice(start, start + length)
        start += length
    return found


PROPRIO_SLICES = name_slices({name: length for name, (length, _) in PROPRIO_FIELDS.items()})
PROPRIO_SIZE = sum(length for length, _ in PROPRIO_FIELDS.values())
PROPRIO_BOUND = np.concatenate([np.full(length, bound, np.float32) for length, bound in PROPRIO_FIELDS.values()])


class StairBlock(NamedTuple):
    """The stair block as named numbers, in the order of STAIR_FIELDS."""

    valid: float = 0.0
    direction: float = 0.0
    step_width: float = 0.0
    step_height: float = 0.0
    edge_distance: float = 0.0
    heading_error: float = 0.0
    age: float = 0.0
    confidence: float = 0.0

    def as_array(self) -> np.ndarray:
        """(8,) float32 within the block's bounds; all zero when invalid."""
        if self.valid < 0.5:
            return np.zeros(len(STAIR_FIELDS), np.float32)
        values = np.array(self, np.float32)
        np.maximum(values, STAIR_LOW, out=values)
        return np.minimum(values, STAIR_HIGH, out=values)

    @classmethod
    def from_array(cls, block: np.ndarray) -> StairBlock:
        """Read a block.

        Raises:
            ValueError: block is not (8,) finite numbers.
        """
        values = np.asarray(block, np.float64)
        if values.shape != (len(STAIR_FIELDS),) or not np.isfinite(values).all():
            raise ValueError(
                f"a stair block is {len(STAIR_FIELDS)} finite numbers ({', '.join(STAIR_FIELDS)}), got {block!r}"
            )
        return cls(*values.tolist())


NO_STAIRS = StairBlock()


def stair_space() -> spaces.Box:
    """Space of the stair block."""
    from gymnasium import spaces

    return spaces.Box(STAIR_LOW, STAIR_HIGH, dtype=np.float32)


def proprio_space(action_size: int = 16) -> spaces.Box:
    """Space of the proprioceptive block, fields in the order of PROPRIO_FIELDS."""
    from gymnasium import spaces

    low, high = _proprio_bounds(PROPRIO_SLICES["last_action"].start + action_size)
    return spaces.Box(low, high, dtype=np.float32)


@functools.cache
def _proprio_bounds(length: int) -> tuple[np.ndarray, np.ndarray]:
    """Low and high (length,); the last action, whose entries are within 1, may be longer or shorter than the gait's."""
    bound = np.concatenate([PROPRIO_BOUND, np.ones(max(0, length - PROPRIO_SIZE), np.float32)])[:length]
    return -bound, bound


def pack_proprio(fields: Mapping[str, np.ndarray | Sequence[float]]) -> np.ndarray:
    """Concatenate named vectors in the documented order, clipped to the space's bounds, float32."""
    parts = [fields[name] for name in PROPRIO_FIELDS]
    packed = np.concatenate(parts, dtype=np.float32, casting="same_kind")
    low, high = _proprio_bounds(len(packed))
    np.minimum(packed, high, out=packed)
    return np.maximum(packed, low, out=packed)
