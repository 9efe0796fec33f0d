"""One prepared frame measured: what `stair-env perceive` and the loggers ask for each frame."""

from __future__ import annotations

import dataclasses
import inspect
from dataclasses import dataclass
from typing import Any

import numpy as np

from perception.estimator import StairEstimator
from perception.geometry.results import StairEstimate
from perception.sources.preparation import SourceFrame
from stair_env.common.constants import LEVEL_CAMERA_GRAVITY

NO_DEPTH = "no depth: lines only, nothing can be measured in millimetres"


@dataclass(frozen=True)
class Measurement:
    """A frame and what was found in it.

    Attributes:
        frame: that was measured.
        estimate: of it.
        grid: the network's cls (32, 16) and loc (32, 16, 8).
        gravity_source: "given", "imu", "level" (nobody said, a level camera was assumed), or what the estimator says it
            made of depth ("refined", "depth").
    """

    frame: SourceFrame
    estimate: StairEstimate
    grid: tuple[np.ndarray, np.ndarray]
    gravity_source: str

    def to_dict(self) -> dict[str, Any]:
        """The JSON object of a frame."""
        return {
            "name": self.frame.name,
            "time_s": self.frame.time_s,
            **dict(zip(("rgb", "depth"), self.frame.files)),
            **self.estimate.to_dict(),
            "gravity_source": self.gravity_source,
            "hints": list(self.frame.hints),
        }


def measure_frame(estimator: StairEstimator, frame: SourceFrame) -> Measurement:
    """Measure one frame; without depth only its lines are found."""
    depth = frame.depth_m if frame.depth_m is not None else np.zeros(frame.rgb.shape[:2], np.float32)
    grid = estimator.detect(frame.rgb, depth)
    known = frame.gravity is not None
    gravity = frame.gravity if known or takes_no_gravity(estimator) else np.array(LEVEL_CAMERA_GRAVITY)
    if frame.depth_m is None:
        level = gravity if gravity is not None else np.array(LEVEL_CAMERA_GRAVITY)
        estimate = estimator.interpret(*grid, depth, frame.intrinsics, level)
        found = dataclasses.replace(estimate, valid=False, direction=0, steps=(), nosings=(), next_edge_m=0.0)
        return Measurement(
            frame, dataclasses.replace(found, reason=NO_DEPTH), grid, frame.gravity_source if known else "level"
        )
    estimate = estimator.interpret(*grid, depth, frame.intrinsics, gravity)
    made = getattr(estimate, "gravity_source", "")
    said = frame.gravity_source if known else "level"
    return Measurement(frame, estimate, grid, said if made in ("", "imu") else str(made))


def takes_no_gravity(estimator: StairEstimator) -> bool:
    """Whether an estimator finds gravity itself where none is given."""
    parameter = inspect.signature(estimator.interpret).parameters.get("gravity")
    return parameter is not None and ("None" in str(parameter.annotation) or parameter.default is None)
