"""Flights for the Rerun viewer: robot, true and measured staircase, what its camera saw, block and reward over time."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from perception.looking.rerun_log import rerun_recording
from policies.report.camera_view import camera_view
from stair_env.common.constants import CONTROL_DT
from stair_env.observation import STAIR_FIELDS
from stair_env.stairs import StairSpec

TRUE, MEASURED, ROBOT = [120, 220, 130], [255, 140, 40], [90, 160, 255]
PICTURES_EVERY = 4  # control steps: the camera takes 15 frames a second
TRUNK_HALF_M = (0.25, 0.12, 0.06)


def open_flights(path: Path) -> contextlib.AbstractContextManager[tuple[Any, Any]]:
    """The module rerun and a recording (.rrd) that takes its place when the block ends.

    Raises:
        MissingExtraError: rerun-sdk is not installed.
    """
    return rerun_recording(path, "stair_env flights", blueprint)


def blueprint(rerun: Any) -> Any:
    """The robot on its stairs and what it sees above, the block beside the truth and the reward's terms below."""
    views = rerun.blueprint
    return views.Blueprint(
        views.Vertical(
            views.Horizontal(
                views.Spatial3DView(name="robot and stairs", origin="world"),
                views.Spatial2DView(name="its camera, with lines", origin="camera"),
                column_shares=[3, 2],
            ),
            views.Horizontal(
                views.TimeSeriesView(name="step width and height, m", origin="block/size"),
                views.TimeSeriesView(name="next edge, m; heading, rad", origin="block/place"),
                views.TimeSeriesView(name="reward terms", origin="reward"),
            ),
            row_shares=[3, 2],
        ),
        collapse_panels=True,
    )


class FlightLog:
    """Logs control steps; the hook of `policies.rollout.run_episode`.

    Args:
        opened: what `open_flights` gave.
        env: that flies.
        start_s: of this flight on the recording's clock.
    """

    def __init__(self, opened: tuple[Any, Any], env: gym.Env, start_s: float = 0.0) -> None:
        self._rr, self._to = opened
        self._env, self.time_s, self._steps = env, start_s, 0
        self._path: list[list[float]] = []

    def add(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> None:
        """Log one control step."""
        rr, truth = self._rr, info["truth"]
        self._to.set_time("flight", duration=self.time_s)
        if self._steps == 0:
            self._to.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
            stairs = self._env.get_wrapper_attr("stairs")
            self._to.log("world/true", rr.LineStrips3D(nosings(stairs), colors=TRUE, radii=0.006))
        self._path.append(list(truth["position"]))
        turn = rr.RotationAxisAngle(axis=[0, 0, 1], radians=truth["yaw"])
        self._to.log("world/robot", rr.Transform3D(translation=truth["position"], rotation=turn))
        self._to.log("world/robot/trunk", rr.Boxes3D(half_sizes=[TRUNK_HALF_M], colors=ROBOT))
        self._to.log("world/path", rr.LineStrips3D([self._path], colors=ROBOT, radii=0.003))
        self._block(observation["stair"], truth)
        for name, value in info["reward_terms"].items():
            self._to.log(f"reward/{name}", rr.Scalars(value))
        if self._steps % PICTURES_EVERY == 0:
            self._picture()
        self._steps += 1
        self.time_s += CONTROL_DT

    def _block(self, block: np.ndarray, truth: Mapping[str, Any]) -> None:
        rr, fields = self._rr, dict(zip(STAIR_FIELDS, np.asarray(block, float).tolist()))
        for values, who in ((fields, "measured"), (truth, "true")):
            if values["valid"] < 0.5:
                continue
            for group, names in (
                ("size", ("step_width", "step_height")),
                ("place", ("edge_distance", "heading_error")),
            ):
                for name in names:
                    self._to.log(f"block/{group}/{name}_{who}", rr.Scalars(float(values[name])))
        hips = float(self._env.get_wrapper_attr("robot").hip_x[0])
        self._to.log("world/measured", rr.LineStrips3D(next_edge(fields, truth, hips), colors=MEASURED, radii=0.01))

    def _picture(self) -> None:
        drawn = camera_view(self._env)
        if drawn is not None:
            self._to.log("camera", self._rr.Image(drawn).compress(jpeg_quality=80))


def nosings(stairs: StairSpec) -> list[np.ndarray]:
    """(2, 3) ends of each true edge, world frame, metres."""
    profile, half = stairs.profile(), stairs.flight_width / 2
    tops = np.maximum(profile.level_z[:-1], profile.level_z[1:])
    return [np.array([[x, -half, z], [x, half, z]]) for x, z in zip(profile.edge_x, tops)]


def next_edge(
    block: Mapping[str, float], truth: Mapping[str, Any], hip_forward_m: float, half_m: float = 0.4
) -> list[np.ndarray]:
    """(2, 3) where the block says that the next edge is, world frame, at the height of the trunk; none when not valid.

    Args:
        block: fields of the stair block, which counts from the front hips.
        truth: `info["truth"]`: where the robot stands, so that the line can be drawn.
        hip_forward_m: front hips before the base, metres.
        half_m: half of the line's length, metres.
    """
    if block["valid"] < 0.5:
        return []
    yaw = float(truth["yaw"])
    hips = np.asarray(truth["position"]) + hip_forward_m * np.array([np.cos(yaw), np.sin(yaw), 0.0])
    yaw += float(block["heading_error"])
    ahead, side = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    middle = hips + ahead * float(block["edge_distance"])
    return [np.array([middle - half_m * side, middle + half_m * side])]
