"""What only a simulator knows, for a critic or a teacher that learns beside a policy which may not see it.

`privileged=True` adds it to the observation under the key "privileged". A policy that reads that key climbs on no
real robot: hide it from the actor (docs/training.md shows how).
"""

from __future__ import annotations

import numpy as np
from gymnasium import spaces

from stair_env.observation import STAIR_FIELDS, STAIR_HIGH, STAIR_LOW, name_slices
from stair_env.task.step_state import StepState

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


def privileged_space() -> spaces.Box:
    """Space of the privileged block: the true stair block, then PRIVILEGED_FIELDS in their order."""
    return spaces.Box(PRIVILEGED_LOW, PRIVILEGED_HIGH, dtype=np.float32)


def pack_privileged(state: StepState) -> np.ndarray:
    """Return the privileged block after a control step, (34,) float32, clipped to its space's bounds."""
    base, episode = state.after, state.episode
    world_to_base = base.rotation.T
    soles = state.feet[:, 2] - episode.robot.foot_radius
    fields = {
        "velocity": world_to_base @ base.velocity,
        "angular_velocity": world_to_base @ base.angular_velocity,
        "base_height": [float(base.position[2]) - state.ground_under_base],
        "foot_clearance": soles - np.array(state.ground_under_feet),
        "foot_force": (state.contacts.force @ base.rotation).ravel(),
        **{name: [value] for name, value in episode.body._asdict().items()},
    }
    packed = np.concatenate([state.truth.as_array(), *(fields[name] for name in PRIVILEGED_FIELDS)], dtype=np.float32)
    clipped: np.ndarray = np.clip(packed, PRIVILEGED_LOW, PRIVILEGED_HIGH)
    return clipped
