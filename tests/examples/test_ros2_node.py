"""ROS messages into joint targets, with stand-ins of the messages; rclpy itself is not here."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from perception.deploy.onnx_actor import OnnxActor
from perception.deploy.ros_wiring import RosWiring
from policies.export_actor import export_actor
from policies.pretrained import load
from stair_env.onboard.kinematics import LegKinematics
from stair_env.robots import get_robot

FILE = Path(__file__).resolve().parents[2] / "examples" / "ros2_node.py"
ROBOT = get_robot("aliengo")
JOINTS = LegKinematics(ROBOT).joint_angles(ROBOT.nominal_feet)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_actor(load("aliengo"), tmp_path_factory.mktemp("actor"))


def node_module() -> Any:
    spec = importlib.util.spec_from_file_location("ros2_node", FILE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def header(time_s: float) -> SimpleNamespace:
    seconds = int(time_s)
    return SimpleNamespace(
        stamp=SimpleNamespace(sec=seconds, nanosec=round(1e9 * (time_s - seconds))), frame_id="camera"
    )


def image(array: np.ndarray, encoding: str, time_s: float) -> SimpleNamespace:
    data = np.ascontiguousarray(array)
    height, width = array.shape[:2]
    step = data.nbytes // height
    return SimpleNamespace(
        header=header(time_s),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=step,
        data=data.tobytes(),
    )


def imu(time_s: float, force: tuple[float, float, float]) -> SimpleNamespace:
    vector = SimpleNamespace(**dict(zip("xyz", force)))
    rate = SimpleNamespace(x=0.001, y=0.0, z=0.0)
    known = np.zeros(9)
    return SimpleNamespace(
        header=header(time_s),
        linear_acceleration=vector,
        angular_velocity=rate,
        linear_acceleration_covariance=known,
        angular_velocity_covariance=known,
    )


def camera_info() -> SimpleNamespace:
    k = [615.0, 0.0, 319.5, 0.0, 615.0, 239.5, 0.0, 0.0, 1.0]
    return SimpleNamespace(width=640, height=480, k=k, d=[0.0] * 5, distortion_model="plumb_bob")


def joint_state() -> SimpleNamespace:
    return SimpleNamespace(position=JOINTS.tolist(), velocity=[0.0] * 12)


def images(time_s: float) -> tuple[SimpleNamespace, SimpleNamespace]:
    colour = image(np.zeros((480, 640, 3), np.uint8), "rgb8", time_s)
    return colour, image(np.full((480, 640), 1500, np.uint16), "16UC1", time_s)


def test_nothing_is_asked_of_the_motors_before_every_sensor_has_spoken_then_it_walks(exported: Path) -> None:
    wiring = RosWiring("aliengo", OnnxActor(exported))
    assert wiring.tick(0.0) is None
    wiring.on_camera_info(camera_info())
    assert wiring.tick(0.0) is None
    wiring.on_joints(joint_state())
    wiring.on_contacts(SimpleNamespace(data=[1.0] * 4))
    for index in range(3):
        time_s = index / 48
        for _ in range(5):
            wiring.on_trunk_imu(imu(time_s, (0.0, 0.0, 9.81)))
            wiring.on_camera_imu(imu(time_s, (0.0, -9.8, 0.0)))
        if index < 2:
            wiring.on_images(*images(time_s))
        targets = wiring.tick(time_s)
        assert targets is not None and targets.shape == (12,) and np.abs(targets - JOINTS).max() < 1.0
    assert wiring.climber is not None
    assert wiring.climber.latency()["network"]["calls"] == 2  # the third tick brought no frame


def test_an_imu_that_marks_its_acceleration_unknown_is_not_used() -> None:
    wiring = RosWiring("aliengo", None)
    wiring.on_camera_info(camera_info())
    wiring.on_joints(joint_state())
    wiring.on_camera_imu(imu(1.0, (0.0, -9.8, 0.0)))
    unknown = imu(1.0, (0.0, 0.0, 9.81))
    unknown.linear_acceleration_covariance = np.full(9, -1.0)
    wiring.on_trunk_imu(unknown)
    assert wiring.tick(1.0) is None
    wiring.on_trunk_imu(imu(1.0, (0.0, 0.0, 9.81)))
    assert wiring.tick(1.0) is not None


class StandInRos:
    """rclpy, message_filters and message types as far as the node uses them; `spin` plays one control step."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.takers: dict[str, Any] = {}
        self.published: list[Any] = []
        message = lambda name: type(name, (SimpleNamespace,), {})  # noqa: E731
        node = SimpleNamespace(
            create_subscription=lambda kind, topic, take, depth: self.takers.update({topic: take}),
            create_publisher=lambda kind, topic, depth: SimpleNamespace(publish=self.published.append),
            create_timer=lambda period_s, tick: setattr(self, "tick", tick),
            get_clock=lambda: SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=0)),
        )
        together = SimpleNamespace(registerCallback=lambda take: self.takers.update(images=take))
        modules: dict[str, dict[str, Any]] = {
            "rclpy": {"init": lambda: None, "create_node": lambda name: node, "spin": self.spin},
            "message_filters": {
                "Subscriber": lambda node, kind, topic: topic,
                "ApproximateTimeSynchronizer": lambda topics, depth, apart_s: together,
            },
            "sensor_msgs": {},
            "sensor_msgs.msg": {name: message(name) for name in ("CameraInfo", "Image", "Imu", "JointState")},
            "std_msgs": {},
            "std_msgs.msg": {"Float64MultiArray": message("Float64MultiArray")},
        }
        for name, parts in modules.items():
            module = ModuleType(name)
            vars(module).update(parts)
            monkeypatch.setitem(sys.modules, name, module)

    def spin(self, node: Any) -> None:
        self.tick()
        self.takers["/camera/color/camera_info"](camera_info())
        self.takers["/joint_states"](joint_state())
        self.takers["/foot_contacts"](SimpleNamespace(data=[1.0] * 4))
        self.takers["/camera/imu"](imu(0.0, (0.0, -9.8, 0.0)))
        self.takers["/trunk/imu"](imu(0.0, (0.0, 0.0, 9.81)))
        self.takers["images"](*images(0.0))
        self.tick()


def test_the_node_brings_topics_to_the_wiring_and_targets_out(exported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ros = StandInRos(monkeypatch)
    node_module().main("aliengo", str(exported))
    (message,) = ros.published  # nothing before the sensors spoke
    assert len(message.data) == 12 and np.abs(np.array(message.data) - JOINTS).max() < 1.0


def test_without_ros_the_node_says_what_it_needs(exported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    monkeypatch.setitem(sys.modules, "message_filters", None)
    with pytest.raises(SystemExit, match="needs ROS 2"):
        node_module().main("aliengo", str(exported))
