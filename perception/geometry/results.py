"""What perception says about a staircase: plain frozen values, no NaN, JSON-able.

Positions are given in the gravity-levelled frame of the camera: "distance" is horizontal, from the colour imager along
the walking direction of the stairs (perpendicular to their lines), "height" is above the imager, negative below.
The step *width* is the tread depth, the step *height* the riser height, as in the StairNetV2 paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from perception.geometry.lines import StairLine

DIRECTION_NAMES = {1: "ascending", -1: "descending", 0: "unknown"}


@dataclass(frozen=True)
class Nosing:
    """One nosing and what is seen of the step behind it; None where this frame does not show it.

    Attributes:
        distance_m, distance_std_m: horizontal, along the walking direction, from the camera; metres.
        height_m, height_std_m: above the camera, metres.
        riser_m, riser_std_m: height of the riser at this nosing (ascending: below it, descending: beyond it), metres.
        tread_m, tread_std_m: run from this nosing to the next one, metres.
    """

    distance_m: float
    distance_std_m: float
    height_m: float
    height_std_m: float
    riser_m: float | None = None
    riser_std_m: float | None = None
    tread_m: float | None = None
    tread_std_m: float | None = None


@dataclass(frozen=True)
class StepMeasurement:
    """One step, both lengths measured; standard deviations in metres.

    Attributes:
        width_m, width_std_m: tread depth.
        height_m, height_std_m: riser height.
        distance_m: horizontal distance from the camera to the riser of the step, along the walking direction.
    """

    width_m: float
    height_m: float
    width_std_m: float
    height_std_m: float
    distance_m: float


@dataclass(frozen=True)
class StairEstimate:
    """One frame's answer.

    Attributes:
        valid: at least one riser was measured and the direction is known.
        direction: +1 ascending, -1 descending, 0 unknown.
        lines: detected lines in pixels of the given image, nearest first.
        steps: complete steps, nearest first.
        nosings: every nosing whose place is known, nearest first.
        pitch_rad, roll_rad: camera attitude by the paper's equation 8 (head up and right side down positive).
        yaw_rad: heading of the camera relative to the stairs; positive when it looks to the right of their walking
            direction, so that it has to turn left to face them.
        yaw_std_rad: its standard deviation.
        next_edge_m: horizontal distance from the camera to the nearest nosing, along the walking direction; 0 when
            not valid.
        reason: why the estimate is not valid; empty when it is.
        gravity_source: what the answer stands upright by: "imu", the given gravity; "refined", that corrected by more
            than a degree after what lies and stands in the picture; "depth", when none was given.
        gravity_correction_rad: angle between the given gravity and the one used; at most six degrees, or `reason`
            says by how many the two disagree. pitch_rad and roll_rad are the corrected ones once `gravity_source` is
            not "imu".
    """

    valid: bool
    direction: int = 0
    lines: tuple[StairLine, ...] = ()
    steps: tuple[StepMeasurement, ...] = ()
    nosings: tuple[Nosing, ...] = ()
    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    yaw_rad: float = 0.0
    yaw_std_rad: float = 0.0
    next_edge_m: float = 0.0
    reason: str = ""
    gravity_source: str = "imu"
    gravity_correction_rad: float = 0.0

    @property
    def direction_name(self) -> str:
        """The direction as a word: "ascending", "descending" or "unknown"."""
        return DIRECTION_NAMES[self.direction]

    def to_dict(self) -> dict[str, Any]:
        """The JSON object that `stair-env perceive` writes per frame."""
        return {
            "valid": self.valid,
            "direction": self.direction_name,
            "lines": [
                {name: getattr(line, name) for name in ("x1", "y1", "x2", "y2", "k", "b", "score", "support", "kind")}
                for line in self.lines
            ],
            "steps": [
                {
                    "width_m": step.width_m,
                    "height_m": step.height_m,
                    "width_std_m": step.width_std_m,
                    "height_std_m": step.height_std_m,
                    "distance_m": step.distance_m,
                }
                for step in self.steps
            ],
            "pitch_rad": self.pitch_rad,
            "roll_rad": self.roll_rad,
            "yaw_rad": self.yaw_rad,
            "next_edge_m": self.next_edge_m,
            "reason": self.reason,
            "gravity_source": self.gravity_source,
            "gravity_correction_rad": self.gravity_correction_rad,
        }


def steps_of(nosings: tuple[Nosing, ...]) -> tuple[StepMeasurement, ...]:
    """Equation 9: the steps whose width and height are both known, nearest first."""
    return tuple(
        StepMeasurement(n.tread_m, n.riser_m, n.tread_std_m or 0.0, n.riser_std_m or 0.0, n.distance_m)
        for n in nosings
        if n.tread_m is not None and n.riser_m is not None
    )
