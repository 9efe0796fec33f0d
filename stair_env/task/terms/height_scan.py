"""Heights of the ground on a grid around the base: what most locomotion policies see stairs by.

Grid and meaning are those of legged_gym (Rudin et al., "Learning to Walk in Minutes", CoRL 2021): 17 × 11 points, 0.1 m
apart, that turn with the base's heading but not with its tilt. What an elevation map gets wrong is modelled coarsely:
noise on each point, a map that lies beside the truth, and age.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from gymnasium import spaces

from stair_env.common.validation import check_range
from stair_env.task.step_state import Episode, StepState

HEIGHT_SCAN_KEY = "height_scan"  # of the observation
GRID_X_M = np.linspace(-0.8, 0.8, 17)  # from behind the base to ahead of it
GRID_Y_M = np.linspace(-0.5, 0.5, 11)  # from its right to its left
SCAN_SIZE = len(GRID_X_M) * len(GRID_Y_M)
SCAN_BOUND_M = 1.0
_STREAM = 187  # keeps its draws apart from those of other terms of the episode


@dataclass(frozen=True)
class HeightScanConfig:
    """How wrong a height scan is.

    Attributes:
        noise_m: standard deviation of each point of each scan.
        shift_m: how far the whole map lies beside the truth at most, along x and along y, drawn once an episode.
        delay_s: age of what is seen.

    Raises:
        SpecError: a value is out of range.
    """

    noise_m: float = 0.02
    shift_m: float = 0.03
    delay_s: float = 0.1

    def __post_init__(self) -> None:
        check_range("height_scan.noise_m", self.noise_m, 0.0, 0.5)
        check_range("height_scan.shift_m", self.shift_m, 0.0, 0.5)
        check_range("height_scan.delay_s", self.delay_s, 0.0, 2.0)


class HeightScan:
    """An observation term: (187,) float32, `reshape(17, 11)` has rows from behind to ahead, columns from right to left.

    A value is the height of the ground above where it would be if the robot stood there, metres: 0 on a floor, a riser
    ahead its height. Seen are stairs, the floors they join and the floor beside them; not walls, rails and furniture.

    Args:
        config: how wrong it is.
    """

    def __init__(self, config: HeightScanConfig | None = None) -> None:
        self.config = config or HeightScanConfig()
        self._grid = np.stack(np.meshgrid(GRID_X_M, GRID_Y_M, indexing="ij")).reshape(2, -1)  # (2, 187)
        self._episode: Episode | None = None

    def __call__(self, state: StepState) -> np.ndarray:
        """The scan that has arrived by the end of a control step."""
        if state.episode is not self._episode:
            self._begin(state)
        scan = true_heights(state, self._grid, self._shift)
        scan += self._rng.normal(0.0, self.config.noise_m, SCAN_SIZE) if self.config.noise_m else 0.0
        self._scans.append(np.clip(scan, -SCAN_BOUND_M, SCAN_BOUND_M).astype(np.float32))
        return self._scans[0]

    def _begin(self, state: StepState) -> None:
        self._episode = state.episode
        self._rng = np.random.default_rng([state.episode.seed, _STREAM])
        self._shift = self._rng.uniform(-1.0, 1.0, 2) * self.config.shift_m
        self._scans: deque[np.ndarray] = deque(maxlen=1 + round(self.config.delay_s / state.dt_s))


def true_heights(state: StepState, grid: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Heights of the ground under a grid around the base, as `HeightScan` counts them, without errors but the shift.

    Args:
        state: of a control step.
        grid: (2, n) x and y, frame that turns with the base's heading, metres.
        shift: (2,) of the map, world frame, metres.

    Returns:
        (n,) float64 metres.
    """
    base, stairs, profile = state.after, state.episode.stairs, state.episode.profile
    cos, sin = np.cos(base.yaw), np.sin(base.yaw)
    x = base.position[0] + shift[0] + cos * grid[0] - sin * grid[1]
    y = base.position[1] + shift[1] + sin * grid[0] + cos * grid[1]
    ground = np.where(np.abs(y) > stairs.flight_width / 2, 0.0, profile.height_at(x))
    heights: np.ndarray = ground - (base.position[2] - state.episode.robot.stand_height)
    return heights


def height_scan_space() -> spaces.Box:
    """Space of the height scan, metres."""
    return spaces.Box(-SCAN_BOUND_M, SCAN_BOUND_M, (SCAN_SIZE,), np.float32)
