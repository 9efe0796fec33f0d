"""A ROS 2 node that climbs: camera, IMUs and joints in, joint targets out. Needs ROS 2 with rclpy and message_filters.

    python -m policies.export_actor aliengo runs/actor        (once, where torch is)
    python examples/ros2_node.py aliengo runs/actor           (on the robot, which needs neither torch nor Gymnasium)

Its message handling is tested with stand-ins of the messages; on a robot it has not been run. The topics are those of
realsense-ros; joints come and go in canonical order and signs (`stair_env.robots`).
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from perception.deploy.climber import CameraReading, StairClimber
from perception.deploy.onnx_actor import OnnxActor
from perception.sources.ros_messages import colour_of, depth_of, imu_of, lens_of, stamp_s
from stair_env.common.constants import CONTROL_DT
from stair_env.onboard.body_sense import BodyReading


class Wiring:
    """From messages to the climber and back; knows nothing of rclpy."""

    def __init__(self, robot: str, actor: str) -> None:
        self.robot, self.actor = robot, OnnxActor(actor)
        self.climber: StairClimber | None = None
        self.begun, self.frame, self.count = False, None, 0
        self.trunk: list[np.ndarray] = []
        self.head: list[np.ndarray] = []
        self.joints, self.contact = None, np.ones(4, bool)

    def on_camera_info(self, message: Any) -> None:
        if self.climber is None:
            self.climber = StairClimber(self.robot, lens_of(message).intrinsics, self.actor)

    def on_images(self, colour: Any, depth: Any) -> None:
        self.frame = CameraReading(self.count, stamp_s(colour), colour_of(colour), depth_of(depth))
        self.count += 1

    def on_trunk_imu(self, message: Any) -> None:
        self._keep(self.trunk, message)

    def on_head_imu(self, message: Any) -> None:
        self._keep(self.head, message)

    @staticmethod
    def _keep(rows: list[np.ndarray], message: Any) -> None:
        force, rate = imu_of(message)
        if force is not None:
            rows.append(np.concatenate([force[1:], np.zeros(3) if rate is None else rate[1:]]))

    def on_joints(self, message: Any) -> None:
        self.joints = (np.array(message.position), np.array(message.velocity))

    def on_contacts(self, message: Any) -> None:
        self.contact = np.array(message.data) > 0.5

    def tick(self, now_s: float) -> np.ndarray | None:
        """Joint targets (12,), radians; None until every sensor has spoken."""
        if self.climber is None or self.joints is None or not self.trunk or not self.head:
            return None
        body = BodyReading(now_s, *self.joints, self.contact, np.array(self.trunk))
        head, frame = np.array(self.head), self.frame
        self.trunk, self.head, self.frame = [], [], None
        step = self.climber.step if self.begun else self.climber.begin
        self.begun = True
        return step(body, head, frame)


def main() -> None:
    import message_filters
    import rclpy
    from sensor_msgs.msg import CameraInfo, Image, Imu, JointState
    from std_msgs.msg import Float64MultiArray

    rclpy.init()
    node, wiring = rclpy.create_node("stair_climber"), Wiring(*sys.argv[1:3])
    images = [
        message_filters.Subscriber(node, Image, f"/camera/{name}/image_raw")
        for name in ("color", "aligned_depth_to_color")
    ]
    message_filters.ApproximateTimeSynchronizer(images, 5, 0.02).registerCallback(wiring.on_images)
    node.create_subscription(CameraInfo, "/camera/color/camera_info", wiring.on_camera_info, 1)
    node.create_subscription(Imu, "/camera/imu", wiring.on_head_imu, 50)
    node.create_subscription(Imu, "/trunk/imu", wiring.on_trunk_imu, 50)
    node.create_subscription(JointState, "/joint_states", wiring.on_joints, 5)
    node.create_subscription(Float64MultiArray, "/foot_contacts", wiring.on_contacts, 5)
    publisher = node.create_publisher(Float64MultiArray, "/joint_targets", 1)

    def tick() -> None:
        targets = wiring.tick(node.get_clock().now().nanoseconds * 1e-9)
        if targets is not None:
            publisher.publish(Float64MultiArray(data=targets.tolist()))

    node.create_timer(CONTROL_DT, tick)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
