"""Everything between a robot's sensors and the stair block, but for the network: reads nothing that a robot has not."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from perception.geometry.results import StairEstimate
from perception.tracking.camera_gravity import CameraAttitude
from perception.tracking.tracker import StairTracker, place_camera
from stair_env.intrinsics import Intrinsics
from stair_env.observation import PROPRIO_SLICES, StairBlock
from stair_env.onboard.kinematics import LegKinematics
from stair_env.robots import RobotSpec, mount_to_base

BODY_MEMORY = 96  # control steps: longer than the camera's latency


@dataclass(frozen=True)
class _BodyMoment:
    """Gravity in the camera frame (3,), and front feet on the ground (n, 3) in the base frame, at a time."""

    time_s: float
    gravity: np.ndarray
    front_feet: np.ndarray


class StairPerception:
    """Everything between a robot's sensors and the stair block, for one robot.

    Args:
        robot: supplies hips and camera mount.
        intrinsics: of the camera's images.
        tracker: of your own configuration; None makes one.
    """

    def __init__(self, robot: RobotSpec, intrinsics: Intrinsics, tracker: StairTracker | None = None) -> None:
        self.intrinsics = intrinsics
        self.tracker = tracker if tracker is not None else StairTracker(robot.hip_x[0])
        self._camera_to_base = mount_to_base(robot.camera)
        self._kinematics, self._foot_radius = LegKinematics(robot), robot.foot_radius
        self._attitude = CameraAttitude()
        self.reset(0.0)

    def reset(self, time_s: float) -> None:
        """Begin an episode."""
        self._attitude.reset()
        self.tracker.reset(time_s)
        self._body: deque[_BodyMoment] = deque(maxlen=BODY_MEMORY)
        self._last_frame: int | None = None
        self.estimate = StairEstimate(valid=False, reason="no frame yet")

    def feel(self, proprio: np.ndarray, imu: np.ndarray, time_s: float) -> None:
        """Take one control step's body sensors in.

        Args:
            proprio: `stair_env.observation.PROPRIO_FIELDS`.
            imu: (k, 6) accelerometer and gyro samples in the camera frame, oldest first.
            time_s: now.
        """
        touching = proprio[PROPRIO_SLICES["contact"]][:2] > 0.5
        feet = self._kinematics.foot_positions(proprio[PROPRIO_SLICES["joint_position"]].astype(np.float64))[:2]
        self._body.append(_BodyMoment(time_s, self._attitude.update(imu), feet[touching]))
        velocity = proprio[PROPRIO_SLICES["velocity"]]
        yaw_rate = float(proprio[PROPRIO_SLICES["yaw_rate"]][0])
        pitch = math.asin(min(max(float(proprio[PROPRIO_SLICES["gravity"]][0]), -1.0), 1.0))
        self.tracker.advance(time_s, float(velocity[0]), float(velocity[1]), yaw_rate, pitch)

    def is_new(self, frame: int) -> bool:
        """Whether a frame of this number has not been looked at yet."""
        return frame != self._last_frame

    def gravity_at(self, time_s: float) -> np.ndarray:
        """(3,) gravity in the camera frame at an earlier time, m/s^2."""
        return self._body_at(time_s).gravity

    def _body_at(self, time_s: float) -> _BodyMoment:
        return min(self._body, key=lambda moment: abs(moment.time_s - time_s))

    def look(self, estimate: StairEstimate, frame: int, captured_at_s: float) -> None:
        """Take the estimate of a frame in."""
        self._last_frame, self.estimate = frame, estimate
        body = self._body_at(captured_at_s)
        up = self._camera_to_base[:3, :3] @ (body.gravity / np.linalg.norm(body.gravity))
        soles = body.front_feet - self._foot_radius * up
        self.tracker.observe(estimate, captured_at_s, place_camera(self._camera_to_base, body.gravity, soles))

    def block(self) -> StairBlock:
        """The stair block for now."""
        return self.tracker.block()
