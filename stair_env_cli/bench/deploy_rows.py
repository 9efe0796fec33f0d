"""What each part of the robot's side takes, beside the control step that it has to fit in."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from stair_env_cli.bench.timing import Row

PARTS = ("body", "network", "geometry", "tracker", "policy", "gait")  # perception.deploy.climber.PARTS
STEPS_A_ROUND, FRAME_EVERY = 24, 3  # control steps: half a second, 16 frames a second
NAMES = tuple(f"deploy-{part}" for part in PARTS)


@functools.cache
def latencies(rounds: int, backend: str) -> dict[str, dict[str, float]]:
    """Milliseconds of each part (`StairClimber.latency`) over `rounds` half seconds.

    The robot walks without a simulator: its joints are where they were asked to be, and its camera keeps seeing the
    same stairs, so that every frame has the work of a good detection.
    """
    from perception.deploy.climber import StairClimber
    from perception.deploy.onnx_actor import OnnxActor
    from perception.deploy.readings import BodyReading, CameraReading
    from perception.estimator import StairEstimator
    from policies.export_actor import export_actor
    from policies.pretrained import load
    from stair_env.common.constants import CONTROL_DT
    from stair_env.onboard.kinematics import LegKinematics
    from stair_env.robots import get_robot
    from stair_env_cli.bench.perception_rows import sample_frame

    robot, sample = get_robot("aliengo"), sample_frame().frame
    with tempfile.TemporaryDirectory() as folder:
        actor = OnnxActor(export_actor(load("aliengo"), Path(folder)))
    climber = StairClimber(robot, sample.intrinsics, actor, StairEstimator(0.25, backend))
    trunk = np.tile([0.0, 0.0, 9.81, 0.0, 0.0, 0.0], (5, 1))
    head = np.tile([*sample.gravity, 0.0, 0.0, 0.0], (5, 1))
    joints = LegKinematics(robot).joint_angles(robot.nominal_feet)
    for step in range(rounds * STEPS_A_ROUND):
        time_s = step * CONTROL_DT
        seen = CameraReading(step // FRAME_EVERY, time_s, sample.rgb, sample.depth_m)
        body = BodyReading(time_s, joints, np.zeros(12), np.ones(4, bool), trunk)
        joints = climber.begin(body, head, seen) if step == 0 else climber.step(body, head, seen)
    return climber.latency()


def _row(part: str, rounds: int, backend: str) -> Row:
    from stair_env.common.constants import CONTROL_DT

    ours, budget = latencies(rounds, backend)[part]["mean_ms"], 1000.0 * CONTROL_DT
    often = "a frame" if part in ("network", "geometry") else "a control step"
    return Row(f"deploy: {part}, {often}, beside a control step", ours, budget, budget / ours, "ms", rounds)


ROWS: dict[str, Callable[[int, str], Row]] = {
    name: functools.partial(_row, part) for name, part in zip(NAMES, PARTS, strict=True)
}
