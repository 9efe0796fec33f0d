"""What only a simulator knows, for a critic or a teacher that learns beside a policy which may not see it.

`privileged=True` adds it to the observation under the key "privileged". A policy that reads that key climbs on no
real robot: hide it from the actor (docs/training.md shows how).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from gymnasium import spaces

from stair_env.observation import STAIR_FIELDS, STAIR_HIGH, STAIR_LOW, StairBlock, name_slices
from stair_env.physics.simulation import BaseState, FootContacts
from stair_env.stairs import StairProfile
from stair_env.task.randomization import Body

PRIVILEGED_FIELDS: dict[str, tuple[int, float]] = {  # name: (length, bound), after the true stair block's eight numbers
    "velocity": (3, 5.0),  # of the base, base frame, m/s
    "angular_velocity": (3, 20.0),  # of the base, base frame, rad/s
    "base_height": (1, 2.0),  # above the ground under it, metres
    "foot_clearance": (4, 1.0),  # of each foot's sole above the ground under it, metres
    "foot_force": (12, 1000.0),  # of the ground on each foot, base frame, newtons
    "friction": (1, 5.0),  # of the ground against the feet
    "payload_kg": (1, 30.0),  # added to the trunk
    "motor_strength": (1, 3.0),  # factor on the largest torques
}
_BOUND = np.concatenate([np.full(length, bound, np.float32) for length, bound in PRIVILEGED_FIELDS.values()])
PRIVILEGED_LOW, PRIVILEGED_HIGH = np.concatenate([STAIR_LOW, -_BOUND]), np.concatenate([STAIR_HIGH, _BOUND])


PRIVILEGED_SLICES = name_slices(
    {"stair": len(STAIR_FIELDS), **{name: length for name, (length, _) in PRIVILEGED_FIELDS.items()}}
)


class Truth(NamedTuple):
    """A moment of an episode as the simulator knows it.

    Attributes:
        stair: the true stair block.
        profile: side view of the stairs.
        state: of the base.
        contacts: of the feet.
        feet: (4, 3) foot centres, world, metres.
        foot_radius: metres.
        body: what was drawn for this episode.
    """

    stair: StairBlock
    profile: StairProfile
    state: BaseState
    contacts: FootContacts
    feet: np.ndarray
    foot_radius: float
    body: Body


def privileged_space() -> spaces.Box:
    """Space of the privileged block: the true stair block, then PRIVILEGED_FIELDS in their order."""
    return spaces.Box(PRIVILEGED_LOW, PRIVILEGED_HIGH, dtype=np.float32)


def pack_privileged(truth: Truth) -> np.ndarray:
    """The privileged block, (34,) float32, clipped to its space's bounds."""
    world_to_base, profile = truth.state.rotation.T, truth.profile
    x, _, z = truth.state.position.tolist()
    fields = {
        "velocity": world_to_base @ truth.state.velocity,
        "angular_velocity": world_to_base @ truth.state.angular_velocity,
        "base_height": [z - profile.level_under(x)],
        "foot_clearance": truth.feet[:, 2] - truth.foot_radius - profile.height_at(truth.feet[:, 0]),
        "foot_force": (truth.contacts.force @ truth.state.rotation).ravel(),
        **{name: [value] for name, value in truth.body._asdict().items()},
    }
    packed = np.concatenate([truth.stair.as_array(), *(fields[name] for name in PRIVILEGED_FIELDS)], dtype=np.float32)
    clipped: np.ndarray = np.clip(packed, PRIVILEGED_LOW, PRIVILEGED_HIGH)
    return clipped
