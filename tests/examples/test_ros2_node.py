"""The ROS 2 node's message handling, with stand-ins of the messages; rclpy itself is not here."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from policies.export_actor import export_actor
from policies.pretrained import load
from stair_env.onboard.kinematics import LegKinematics
from stair_env.robots import get_robot

FILE = Path(__file__).resolve().parents[2] / "examples" / "ros2_node.py"


@pytest.fixture(scope="module")
def wiring(tmp_path_factory: pytest.TempPathFactory) -> Any:
    spec = importlib.util.spec_from_file_location("ros2_node", FILE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Wiring("aliengo", str(export_actor(load("aliengo"), tmp_path_factory.mktemp("actor"))))


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


def test_nothing_is_asked_of_the_motors_before_every_sensor_has_spoken_then_it_walks(wiring: Any) -> None:
    assert wiring.tick(0.0) is None
    k = [615.0, 0.0, 319.5, 0.0, 615.0, 239.5, 0.0, 0.0, 1.0]
    wiring.on_camera_info(SimpleNamespace(width=640, height=480, k=k, d=[0.0] * 5, distortion_model="plumb_bob"))
    assert wiring.tick(0.0) is None
    robot = get_robot("aliengo")
    joints = LegKinematics(robot).joint_angles(robot.nominal_feet)
    wiring.on_joints(SimpleNamespace(position=joints.tolist(), velocity=[0.0] * 12))
    wiring.on_contacts(SimpleNamespace(data=[1.0] * 4))
    for index in range(3):
        time_s = index / 48
        for _ in range(5):
            wiring.on_trunk_imu(imu(time_s, (0.0, 0.0, 9.81)))
            wiring.on_head_imu(imu(time_s, (0.0, -9.8, 0.0)))
        if index < 2:
            wiring.on_images(
                image(np.zeros((480, 640, 3), np.uint8), "rgb8", time_s),
                image(np.full((480, 640), 1500, np.uint16), "16UC1", time_s),
            )
        targets = wiring.tick(time_s)
        assert targets.shape == (12,) and np.abs(targets - joints).max() < 1.0
    assert wiring.climber.latency()["network"]["calls"] == 2  # the third tick brought no frame


def test_an_imu_that_marks_its_acceleration_unknown_is_not_used(wiring: Any) -> None:
    before = len(wiring.trunk)
    message = imu(1.0, (0.0, 0.0, 9.81))
    message.linear_acceleration_covariance = np.full(9, -1.0)
    wiring.on_trunk_imu(message)
    assert len(wiring.trunk) == before
