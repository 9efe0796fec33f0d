"""How many metres a grey level of 8-bit depth stands for, from what the stairs in view would measure.

One frame says nothing about scale but this: stairs are built for legs. Twice the riser and the tread together are close
to a step of a person, 0.63 m (Blondel's rule; building codes ask 0.60 to 0.66 m), so the stairs in view are a ruler of
some 5 %.
"""

from __future__ import annotations

import numpy as np

from perception.estimator import StairEstimator
from stair_env.intrinsics import Intrinsics

STEP_RULE_M = 0.63  # twice the riser and the tread
STEP_RULE_STD_M = 0.03
START_M = (0.007, 0.014, 0.0035, 0.031)  # levels that are tried: the public set's, twice and half of it, 8 m in 255
REFINEMENTS = 2
LEVEL_RANGE_M = (0.001, 0.06)


def estimate_grey_level(
    rgb: np.ndarray, levels: np.ndarray, intrinsics: Intrinsics, gravity: np.ndarray, estimator: StairEstimator
) -> tuple[float, float] | None:
    """Find the scale of one frame.

    Args:
        rgb: uint8 (H, W, 3).
        levels: uint8 (H, W), proportional to depth, 0 = no reading.
        intrinsics: of both.
        gravity: (3,) accelerometer at rest, camera axes.
        estimator: measures the stairs.

    Returns:
        Metres a level and its standard deviation, or None when no step can be measured at any scale.
    """
    for start in START_M:
        level = start
        for _ in range(REFINEMENTS + 1):
            estimate = estimator.estimate(rgb, levels.astype(np.float32) * np.float32(level), intrinsics, gravity)
            if not estimate.valid or not estimate.steps:
                break
            found = float(np.median([2.0 * step.height_m + step.width_m for step in estimate.steps]))
            level *= STEP_RULE_M / found
            if not LEVEL_RANGE_M[0] < level < LEVEL_RANGE_M[1]:
                break
        else:
            return level, level * STEP_RULE_STD_M / STEP_RULE_M
    return None
