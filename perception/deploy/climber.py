"""Estimator, tracker, policy and gait as one object: a robot's readings in, joint targets out.

It does in the same order, with the same code, what the environment and its wrapper do around the simulator; that the
joint targets are equal over a whole flight is tested.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import numpy as np

from perception.deploy.onnx_actor import OnnxActor
from perception.deploy.readings import BodyReading, CameraReading
from perception.estimator import StairEstimator, check_images
from perception.geometry.results import StairEstimate
from perception.tracking.stair_perception import StairPerception
from perception.tracking.tracker import StairTracker
from stair_env.common.constants import CONTROL_DT, PHYSICS_RATE_HZ
from stair_env.intrinsics import Intrinsics
from stair_env.observation import StairBlock
from stair_env.onboard.gait import ACTION_SIZE, Gait
from stair_env.onboard.proprioception import Proprioception
from stair_env.robots import RobotSpec, get_robot

PARTS = ("body", "network", "geometry", "tracker", "policy", "gait")


class Actor(Protocol):
    """What modulates the gait: an `OnnxActor`, or a policy of your own."""

    def act(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        """(16,) action in [-1, 1] for `proprio` and `stair`."""


class StairClimber:
    """Climbs stairs on what a camera sees, 48 times a second.

    Args:
        robot: name in `stair_env.robots.ROBOTS`, or a robot of your own.
        intrinsics: of the camera's images.
        actor: modulates the gait; None walks on the gait alone.
        estimator: None loads StairNetV2 0.25x for ONNX Runtime.
        tracker: of your own configuration.
        imu_rate_hz: of the trunk's IMU.

    Attributes:
        estimate: of the last frame.

    Raises:
        ValueError: no such robot.
    """

    def __init__(
        self,
        robot: str | RobotSpec,
        intrinsics: Intrinsics,
        actor: OnnxActor | Actor | None = None,
        estimator: StairEstimator | None = None,
        tracker: StairTracker | None = None,
        imu_rate_hz: float = PHYSICS_RATE_HZ,
    ) -> None:
        self.robot = get_robot(robot) if isinstance(robot, str) else robot
        self._actor = actor
        self._estimator = estimator if estimator is not None else StairEstimator(refine_gravity=False)
        self._perception = StairPerception(self.robot, intrinsics, tracker)
        self._sense, self._gait = Proprioception(self.robot, imu_rate_hz), Gait(self.robot)
        self._targets: np.ndarray | None = None
        self._last_action = np.zeros(ACTION_SIZE)
        self._spent: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0, 0.0])

    @property
    def estimate(self) -> StairEstimate:
        """Of the last frame."""
        return self._perception.estimate

    @property
    def block(self) -> StairBlock:
        """The stair block as it is now."""
        return self._perception.block()

    def begin(
        self,
        body: BodyReading,
        camera_imu: np.ndarray,
        frame: CameraReading | None = None,
        *,
        rest: np.ndarray | None = None,
        targets: np.ndarray | None = None,
        phase: float = 0.0,
        pitch: float = 0.0,
    ) -> np.ndarray:
        """Start from standing still, before stairs or on them.

        Args:
            body: readings of the standing robot.
            camera_imu: (k, 6) the camera's accelerometer and gyro, camera axes, oldest first.
            frame: the first, when there is one.
            rest: (3,) the trunk's accelerometer at rest, base axes; None takes the mean of `body`.
            targets: (12,) joint angles that the motors hold; None takes the measured ones.
            phase: of the trot, 0..1.
            pitch: of the standing trunk, nose down, radians.

        Returns:
            As `step`.
        """
        self._sense.reset(body.imu[:, :3].mean(axis=0) if rest is None else np.asarray(rest, np.float64))
        self._gait.reset(self._sense.foot_heights(body.joint_position), phase=phase, pitch=pitch)
        self._perception.reset(body.time_s)
        self._targets = body.joint_position.copy() if targets is None else np.asarray(targets, np.float64)
        self._last_action = np.zeros(ACTION_SIZE)
        return self._act(body, camera_imu, frame)

    def step(self, body: BodyReading, camera_imu: np.ndarray, frame: CameraReading | None = None) -> np.ndarray:
        """One control step of 1/48 s.

        Args:
            body: readings since the last step.
            camera_imu: (k, 6) the camera's accelerometer and gyro since then, camera axes, oldest first.
            frame: the newest, if it is new; the same number again is not looked at twice.

        Returns:
            (12,) joint angles to ask for, canonical (`stair_env.robots`), radians.

        Raises:
            RuntimeError: `begin` was not called.
            ValueError: a reading has a wrong shape.
        """
        if self._targets is None:
            raise RuntimeError("call begin() before step()")
        with self._timed("body"):
            self._sense.update(body.imu, body.joint_position, body.contact, CONTROL_DT)
        return self._act(body, camera_imu, frame)

    def _act(self, body: BodyReading, camera_imu: np.ndarray, frame: CameraReading | None) -> np.ndarray:
        assert self._targets is not None
        with self._timed("body"):
            proprio = self._sense.block(
                body.joint_position, body.joint_velocity, self._targets, body.contact, self._gait, self._last_action
            )
            self._perception.feel(proprio, camera_imu, body.time_s)
        if frame is not None and self._perception.is_new(frame.number):
            self._look(frame)
        with self._timed("tracker"):
            block = self._perception.block()
        with self._timed("policy"):
            action = np.zeros(ACTION_SIZE)
            if self._actor is not None:
                action = np.asarray(self._actor.act({"proprio": proprio, "stair": block.as_array()}), np.float64)
            action = np.minimum(np.maximum(action, -1.0), 1.0)
        with self._timed("gait"):
            self._targets = self._gait.joint_targets(action, block, self._sense.velocity, CONTROL_DT)
        self._last_action = action
        return self._targets.copy()

    def _look(self, frame: CameraReading) -> None:
        check_images(frame.rgb, frame.depth_m)
        gravity = self._perception.gravity_at(frame.captured_at_s)
        with self._timed("network"):
            grid = self._estimator.detect(frame.rgb, frame.depth_m)
        with self._timed("geometry"):
            estimate = self._estimator.interpret(*grid, frame.depth_m, self._perception.intrinsics, gravity)
        with self._timed("tracker"):
            self._perception.look(estimate, frame.number, frame.captured_at_s)

    @contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        spent = time.perf_counter() - start
        count, total, most = self._spent[part]
        self._spent[part] = [count + 1, total + spent, max(most, spent)]

    def latency(self) -> dict[str, dict[str, float]]:
        """What each part has taken so far: part -> {"calls", "mean_ms", "max_ms"}, in the order of PARTS."""
        return {
            part: {
                "calls": self._spent[part][0],
                "mean_ms": 1000.0 * self._spent[part][1] / self._spent[part][0],
                "max_ms": 1000.0 * self._spent[part][2],
            }
            for part in PARTS
            if self._spent[part][0]
        }
