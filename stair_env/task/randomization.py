"""Domain randomisation: what is drawn about the robot's body and the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from stair_env.common.field_kinds import naming_fields
from stair_env.common.validation import as_range, check_range, from_mapping
from stair_env.physics.motors import MotorBody

Range = tuple[float, float]


class Body(NamedTuple):
    """What is drawn about the robot's body and the ground for one episode.

    Attributes:
        friction: of the ground against rubber feet.
        payload_kg: added to the trunk.
        motor_strength: factor on the largest torques.
    """

    friction: float
    payload_kg: float
    motor_strength: float


@dataclass(frozen=True)
class Randomization:
    """Domain randomisation of the body and the ground; each pair is drawn from uniformly, once per episode.

    Attributes:
        friction: of the ground against rubber feet.
        payload_kg: added to the trunk.
        motor_strength: factor on the largest torques.
        push_speed: largest sudden change of the trunk's velocity, m/s.
        push_interval_s: mean time between pushes; 0 means none.
        command_latency: chance that a control step's command arrives one step late.
        camera_tilt_rad: largest error of the camera's mounting pitch and roll.
        stiffness, damping: factors on kp and kd, where joints are under PD control.
    """

    friction: Range = (0.7, 1.1)
    payload_kg: Range = (-0.5, 1.5)
    motor_strength: Range = (0.9, 1.1)
    push_speed: float = 0.2
    push_interval_s: float = 4.0
    command_latency: float = 0.1
    camera_tilt_rad: float = 0.01
    stiffness: Range = (0.9, 1.1)
    damping: Range = (0.9, 1.1)

    @naming_fields
    def __post_init__(self) -> None:
        object.__setattr__(self, "friction", as_range("randomization.friction", self.friction, 0.1, 5.0))
        object.__setattr__(self, "payload_kg", as_range("randomization.payload_kg", self.payload_kg, -10.0, 30.0))
        strength = as_range("randomization.motor_strength", self.motor_strength, 0.1, 3.0)
        object.__setattr__(self, "motor_strength", strength)
        for name in ("stiffness", "damping"):
            object.__setattr__(self, name, as_range(f"randomization.{name}", getattr(self, name), 0.1, 3.0))
        check_range("randomization.push_speed", self.push_speed, 0.0, 5.0)
        check_range("randomization.push_interval_s", self.push_interval_s, 0.0, 1e4)
        check_range("randomization.command_latency", self.command_latency, 0.0, 1.0)
        check_range("randomization.camera_tilt_rad", self.camera_tilt_rad, 0.0, 0.2)

    def draw(self, rng: np.random.Generator) -> Body:
        """One episode's body."""
        return Body(*(float(rng.uniform(*span)) for span in (self.friction, self.payload_kg, self.motor_strength)))

    def draw_motors(self, strength: float, rng: np.random.Generator) -> MotorBody:
        """One episode's motors, of a strength that was drawn before."""
        return MotorBody(strength, *(float(rng.uniform(*span)) for span in (self.stiffness, self.damping)))


NOMINAL = Randomization((0.9, 0.9), (0.0, 0.0), (1.0, 1.0), 0.0, 0.0, 0.0, 0.0, (1.0, 1.0), (1.0, 1.0))


def read_randomization(value: Any) -> Randomization:
    """None or False: nominal body. True: the defaults. A mapping: the defaults with changes. A Randomization: itself.

    Raises:
        SpecError: anything else, or a wrong field.
    """
    if value is None or value is False:
        return NOMINAL
    if value is True:
        return Randomization()
    if isinstance(value, Randomization):
        return value
    return from_mapping("randomization", Randomization, value)
