"""Constant modulations of the gait, one upstairs and another downstairs: a wider and lower stance climbs where it ends.

docs/climbing.md tells how they were found. `policies.train.warm_start` fits networks to them,
`policies.joint_level.teaching` teaches with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from stair_env.observation import PROPRIO_SLICES, STAIR_FIELDS
from stair_env.onboard.gait import GaitConfig
from stair_env.robots import LEG_SIDE

DOWNHILL_M = 0.05  # front footholds so far below the rear ones: on a flight down of which no edge is in sight


@dataclass(frozen=True)
class Stance:
    """A constant modulation of the gait, the same for left and right.

    Attributes:
        lower: how much closer the trunk comes to the feet, metres.
        widen: how much farther out the feet stand, metres.
        lean: how far the trunk moves forward over the feet, metres.
        rear_ahead: how much farther forward the rear feet stand, metres.
        pitch: nose down, radians.
        speed, frequency: relative change.
        clearance: metres.
    """

    lower: float = 0.0
    widen: float = 0.0
    lean: float = 0.0
    rear_ahead: float = 0.0
    pitch: float = 0.0
    speed: float = 0.0
    frequency: float = 0.0
    clearance: float = 0.0

    def action(self, config: GaitConfig | None = None) -> np.ndarray:
        """(16,) float32 in [-1, 1] for a trot with these numbers or the usual ones, as near as an action comes."""
        config = config or GaitConfig()
        ahead = np.array([0.0, 0.0, self.rear_ahead, self.rear_ahead]) - self.lean
        feet = np.column_stack([ahead, LEG_SIDE * self.widen, np.full(4, self.lower)])
        rest = (
            self.speed / config.speed_range,
            self.clearance / config.clearance_range,
            self.frequency / config.frequency_range,
            self.pitch / config.pitch_range,
        )
        return np.clip(np.concatenate([feet.ravel() / config.residual_m, rest]), -1.0, 1.0).astype(np.float32)


# Robot: (up, down), tried on risers of 0.18-0.23 m (AlienGo) and 0.20 m (A1), steep stairs and pushes of 1 m/s.
STANCES: dict[str, tuple[Stance, Stance]] = {
    "aliengo": (
        Stance(lower=0.05, widen=0.055, frequency=0.2),
        Stance(lower=0.04, widen=0.055, lean=0.03, pitch=0.13),
    ),
    "a1": (
        Stance(lower=0.03, widen=0.04, rear_ahead=0.03, pitch=-0.05, speed=-0.1, frequency=0.2),
        Stance(lower=0.05, widen=0.05, lean=0.02, pitch=0.1, frequency=0.2),
    ),
}


def stance_actions(observation: Mapping[str, np.ndarray], up: np.ndarray, down: np.ndarray) -> np.ndarray:
    """The action for each of a batch of observations.

    Args:
        observation: `proprio` (B, n) and `stair` (B, 8), not normalised.
        up, down: (16,) actions.

    Returns:
        (B, 16) float32.
    """
    stair, footholds = observation["stair"], observation["proprio"][:, PROPRIO_SLICES["foothold_height"]]
    falls_away = footholds[:, :2].mean(axis=1) - footholds[:, 2:].mean(axis=1) < -DOWNHILL_M
    leads_down = stair[:, STAIR_FIELDS.index("direction")] < 0
    descending = np.where(stair[:, STAIR_FIELDS.index("valid")] > 0.5, leads_down, falls_away)
    return np.where(descending[:, None], down, up).astype(np.float32)
