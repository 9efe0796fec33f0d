"""A ROS 2 node that climbs: camera, IMUs and joints in, joint targets out. Needs ROS 2 with rclpy and message_filters.

    python -m policies.export_actor aliengo runs/actor        (once, where torch is)
    python examples/ros2_node.py aliengo runs/actor           (on the robot, which needs neither torch nor Gymnasium)

What it does with messages (`perception.deploy.ros_wiring`) is tested with stand-ins, and so is this file; on a robot it
has not been run. Topics are realsense-ros's; joints come and go in canonical order and signs (`stair_env.robots`).
"""

from __future__ import annotations

import sys
from typing import Any

from perception.deploy.onnx_actor import OnnxActor
from perception.deploy.ros_wiring import RosWiring
from stair_env.common.constants import CONTROL_DT

IMAGES = ("/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw")
APART_S = 0.02  # at most, colour and depth of one frame


def main(robot: str, actor: str) -> None:
    try:
        import message_filters
        import rclpy
        from sensor_msgs.msg import CameraInfo, Image, Imu, JointState
        from std_msgs.msg import Float64MultiArray
    except ImportError as error:
        raise SystemExit(f"this node needs ROS 2 ({error}): source its setup.bash first") from None
    wiring = RosWiring(robot, OnnxActor(actor))
    rclpy.init()
    node: Any = rclpy.create_node("stair_climber")
    images = [message_filters.Subscriber(node, Image, topic) for topic in IMAGES]
    message_filters.ApproximateTimeSynchronizer(images, 5, APART_S).registerCallback(wiring.on_images)
    for kind, topic, take in (
        (CameraInfo, "/camera/color/camera_info", wiring.on_camera_info),
        (Imu, "/camera/imu", wiring.on_camera_imu),
        (Imu, "/trunk/imu", wiring.on_trunk_imu),
        (JointState, "/joint_states", wiring.on_joints),
        (Float64MultiArray, "/foot_contacts", wiring.on_contacts),
    ):
        node.create_subscription(kind, topic, take, 50)
    publisher = node.create_publisher(Float64MultiArray, "/joint_targets", 1)

    def tick() -> None:
        targets = wiring.tick(node.get_clock().now().nanoseconds * 1e-9)
        if targets is not None:
            publisher.publish(Float64MultiArray(data=targets.tolist()))

    node.create_timer(CONTROL_DT, tick)
    rclpy.spin(node)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit("usage: python examples/ros2_node.py ROBOT ACTOR_FOLDER")
    main(*sys.argv[1:])
