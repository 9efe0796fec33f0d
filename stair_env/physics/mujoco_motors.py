"""Position motors in MuJoCo that behave as Bullet's do: constraints of the solver, with a largest torque.

Bullet's motor asks that a joint's velocity after a step be v + kp·(target − q)/dt + kd·(rate − v), and finds the torque
for it together with the contacts, as long as there is enough of it. Here an equality constraint asks for the same
change of velocity in the same time, as an acceleration. MuJoCo knows no largest force of an equality: a joint whose
constraint took more than the motor has gets the motor's whole torque in its place, and the step is solved again.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from stair_env.common.constants import PHYSICS_RATE_HZ
from stair_env.physics.interface import POSITION_GAIN, VELOCITY_GAIN


class ConstraintMotors:
    """A motor at each joint.

    Args:
        model, data: of MuJoCo; the model's only equality constraints are the motors.
        rates: (12,) the joints' places among velocities.

    Attributes:
        torques: (12,) of the last step, N·m, in the URDF's sense.
    """

    def __init__(self, model: Any, data: Any, rates: np.ndarray) -> None:
        self._model, self._data, self._rates = model, data, rates
        self.torques = np.zeros(len(rates))
        self._limit = np.inf
        # A velocity's error dies off within a physics step of ours by the same share, whatever MuJoCo's time step; the
        # angle's error then at Bullet's pace relative to it.
        step = model.opt.timestep
        damping = (1.0 - (1.0 - VELOCITY_GAIN) ** (step * PHYSICS_RATE_HZ)) / step
        self._lead_s = VELOCITY_GAIN / (POSITION_GAIN * PHYSICS_RATE_HZ)  # damping / stiffness
        hardness = model.eq_solimp[0, 1]
        model.eq_solref[:] = (-damping / self._lead_s * hardness**2, -damping * hardness)

    def command(self, targets: np.ndarray, rates: np.ndarray, limit: float) -> None:
        """Take targets.

        Args:
            targets: (12,) radians, in the URDF's sense.
            rates: (12,) at which the joints are to move there, rad/s.
            limit: the largest torque, N·m.
        """
        self._model.eq_data[:, 0] = targets + self._lead_s * rates  # the constraint damps against standing still
        self._limit = limit

    def release(self) -> None:
        """Let go of the joints."""
        self._data.eq_active[:] = False
        self.torques[:] = 0.0

    def step(self) -> None:
        """Advance one time step of MuJoCo."""
        model, data, rates = self._model, self._data, self._rates
        active = np.ones(len(rates), bool)
        data.eq_active[:] = True
        data.qfrc_applied[rates] = 0.0
        while True:  # once in most steps; each time round, fewer constraints are left
            mujoco.mj_forward(model, data)
            self.torques[active] = data.efc_force[: data.ne]  # equalities come first, in their order
            weak = active & (np.abs(self.torques) > self._limit)
            if not weak.any():
                break
            self.torques[weak] = np.copysign(self._limit, self.torques[weak])
            active &= ~weak
            data.eq_active[:] = active
            data.qfrc_applied[rates] = np.where(active, 0.0, self.torques)
        mujoco.mj_implicit(model, data)
