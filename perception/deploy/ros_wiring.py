"""From ROS messages to a `StairClimber` and back; knows nothing of rclpy, and takes ROS 1 and ROS 2 messages alike."""

from __future__ import annotations

from typing import Any

import numpy as np

from perception.deploy.climber import Actor, StairClimber
from perception.deploy.readings import BodyReading, CameraReading
from perception.sources.ros_messages import colour_of, depth_of, imu_of, lens_of, stamp_s


class RosWiring:
    """Collects what comes between two control steps.

    Args:
        robot: name in `stair_env.robots.ROBOTS`.
        actor: modulates the gait; None walks on the gait alone.

    Attributes:
        climber: None until the camera has told its intrinsics.
    """

    def __init__(self, robot: str, actor: Actor | None) -> None:
        self.climber: StairClimber | None = None
        self._robot, self._actor, self._begun = robot, actor, False
        self._frame: CameraReading | None = None
        self._frames = 0
        self._imus: dict[str, list[np.ndarray]] = {"trunk": [], "camera": []}
        self._joints: tuple[np.ndarray, np.ndarray] | None = None
        self._contact = np.ones(4, bool)

    def on_camera_info(self, message: Any) -> None:
        """Take a sensor_msgs/CameraInfo; the first one counts."""
        if self.climber is None:
            self.climber = StairClimber(self._robot, lens_of(message).intrinsics, self._actor)

    def on_images(self, colour: Any, depth: Any) -> None:
        """Take two sensor_msgs/Image of one time: colour, and depth aligned to it."""
        self._frame = CameraReading(self._frames, stamp_s(colour), colour_of(colour), depth_of(depth))
        self._frames += 1

    def on_trunk_imu(self, message: Any) -> None:
        """Take a sensor_msgs/Imu in the base's axes."""
        self._keep("trunk", message)

    def on_camera_imu(self, message: Any) -> None:
        """Take a sensor_msgs/Imu in the camera's optical axes."""
        self._keep("camera", message)

    def _keep(self, which: str, message: Any) -> None:
        force, rate = imu_of(message)
        if force is not None:
            self._imus[which].append(np.concatenate([force[1:], np.zeros(3) if rate is None else rate[1:]]))

    def on_joints(self, message: Any) -> None:
        """Take a sensor_msgs/JointState in canonical order and signs (`stair_env.robots`)."""
        self._joints = (np.array(message.position), np.array(message.velocity))

    def on_contacts(self, message: Any) -> None:
        """Take a std_msgs/Float64MultiArray: of FR, FL, RR, RL, 1 where the foot touches the ground."""
        self._contact = np.array(message.data) > 0.5

    def tick(self, now_s: float) -> np.ndarray | None:
        """Joint targets (12,), radians; None until every sensor has spoken.

        Args:
            now_s: on the clock of the images' stamps.
        """
        trunk, camera = self._imus["trunk"], self._imus["camera"]
        if self.climber is None or self._joints is None or not trunk or not camera:
            return None
        body, frame = BodyReading(now_s, *self._joints, self._contact, np.array(trunk)), self._frame
        self._imus, self._frame = {"trunk": [], "camera": []}, None
        move = self.climber.step if self._begun else self.climber.begin
        self._begun = True
        return move(body, np.array(camera), frame)
