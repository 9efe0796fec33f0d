"""What was seen and measured, for the Rerun viewer (`stair-env[rerun]`): colour, depth, lines, cloud, steps."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from perception.drawing import KIND_COLOURS
from perception.geometry.planes import camera_to_level
from perception.geometry.results import StairEstimate
from perception.looking.frame_measurement import Measurement
from perception.sources.source import MissingExtraError
from stair_env.common.constants import LEVEL_CAMERA_GRAVITY

CLOUD_STRIDE = 4  # pixels between points of the cloud
FAR_M = 4.0  # beyond it depth is not drawn
TREAD_WIDTH_M = 0.8  # to which measured steps are drawn


def load_rerun() -> Any:
    """The module rerun.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import rerun
        import rerun.blueprint
    except ImportError as error:
        raise MissingExtraError(f"--rerun needs rerun-sdk ({error}): pip install 'stair-env[rerun]'") from None
    return rerun


@contextlib.contextmanager
def rerun_recording(path: Path, application: str, make_blueprint: Callable[[Any], Any]) -> Iterator[tuple[Any, Any]]:
    """The module rerun and a recording (.rrd) that takes its place when the block ends.

    Args:
        path: of the file.
        application: name under which the viewer remembers its layout.
        make_blueprint: from the module rerun to how the file opens.

    Raises:
        MissingExtraError: rerun-sdk is not installed.
    """
    from stair_env.common.files import atomic_path

    rerun = load_rerun()
    with atomic_path(path) as temporary:
        recording = rerun.RecordingStream(application)
        recording.save(str(temporary), default_blueprint=make_blueprint(rerun))
        yield rerun, recording
        recording.flush()
        recording.disconnect()


@contextlib.contextmanager
def rerun_log(path: Path) -> Iterator[RerunLog]:
    """Write measurements into a recording (.rrd); it takes its place when the block ends.

    Raises:
        MissingExtraError: rerun-sdk is not installed.
    """
    with rerun_recording(path, "stair_env", blueprint) as opened:
        yield RerunLog(*opened)


def blueprint(rerun: Any) -> Any:
    """Cloud and steps in space on the left, the picture with its lines and depth on the right, figures below."""
    views = rerun.blueprint
    return views.Blueprint(
        views.Vertical(
            views.Horizontal(
                views.Spatial3DView(name="staircase", origin="world"),
                views.Vertical(
                    views.Spatial2DView(name="colour and lines", origin="world/camera/image"),
                    views.Spatial2DView(name="depth", origin="world/camera/depth"),
                ),
                column_shares=[3, 2],
            ),
            views.Horizontal(
                views.TimeSeriesView(name="step height and width, mm", origin="steps"),
                views.TextLogView(name="hints and reasons", origin="log"),
                column_shares=[3, 2],
            ),
            row_shares=[3, 1],
        ),
        collapse_panels=True,
    )


class RerunLog:
    """Takes measurements one by one.

    Args:
        rerun: the module.
        recording: an `rr.RecordingStream`.
    """

    def __init__(self, rerun: Any, recording: Any) -> None:
        self._rr, self._to = rerun, recording
        self._to.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def add(self, measured: Measurement) -> None:
        """Log one frame at its time."""
        rr, frame = self._rr, measured.frame
        self._to.set_time("frame", duration=max(frame.time_s, 0.0))
        gravity = frame.gravity if frame.gravity is not None else np.array(LEVEL_CAMERA_GRAVITY)
        rotation = camera_to_upright(gravity)
        self._to.log("world/camera", rr.Transform3D(mat3x3=rotation))
        model = frame.intrinsics
        pinhole = rr.Pinhole(
            focal_length=[model.fx, model.fy],
            principal_point=[model.cx, model.cy],
            width=model.width,
            height=model.height,
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=0.2,
        )
        self._to.log("world/camera/image", pinhole)
        self._to.log("world/camera/image", rr.Image(frame.rgb).compress(jpeg_quality=80))
        self._lines(measured.estimate)
        if frame.depth_m is not None:
            self._to.log("world/camera/depth", rr.DepthImage(frame.depth_m, meter=1.0, depth_range=[0.2, FAR_M]))
            points, colours = cloud(frame.rgb, frame.depth_m, model.rays())
            self._to.log("world/cloud", rr.Points3D(points @ rotation.T, colors=colours, radii=0.004))
        self._steps(measured.estimate)
        for text in (*frame.hints, *([measured.estimate.reason] if measured.estimate.reason else [])):
            self._to.log("log", rr.TextLog(text))

    def _lines(self, estimate: StairEstimate) -> None:
        ends = [[[line.x1, line.y1], [line.x2, line.y2]] for line in estimate.lines]
        colours = [KIND_COLOURS[line.kind] for line in estimate.lines]
        self._to.log("world/camera/image/lines", self._rr.LineStrips2D(ends, colors=colours, radii=1.5))

    def _steps(self, estimate: StairEstimate) -> None:
        rr = self._rr
        self._to.log("world/measured", rr.LineStrips3D(treads(estimate), colors=[255, 140, 40], radii=0.006))
        if estimate.valid and estimate.steps:
            step = estimate.steps[0]
            self._to.log("steps/height", rr.Scalars(1000.0 * step.height_m))
            self._to.log("steps/width", rr.Scalars(1000.0 * step.width_m))
            self._to.log("steps/next_edge", rr.Scalars(1000.0 * estimate.next_edge_m))


def camera_to_upright(gravity: np.ndarray) -> np.ndarray:
    """(3, 3) rotation from the camera's axes to a level frame: x ahead, y left, z up."""
    right, down, ahead = camera_to_level(gravity)
    return np.stack([ahead, -right, -down])


def cloud(rgb: np.ndarray, depth_m: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) points in camera axes, metres, and their (n, 3) colours, thinned out."""
    thin = (slice(None, None, CLOUD_STRIDE), slice(None, None, CLOUD_STRIDE))
    depth = depth_m[thin]
    near = (depth > 0.0) & (depth < FAR_M)
    return (rays[thin] * depth[..., None])[near], rgb[thin][near]


def treads(estimate: StairEstimate) -> list[np.ndarray]:
    """Outlines of the measured nosings and the treads behind them, (n, 3) each, in the level frame of the camera."""
    ahead = np.array([np.cos(estimate.yaw_rad), np.sin(estimate.yaw_rad), 0.0])
    side = np.array([-ahead[1], ahead[0], 0.0]) * TREAD_WIDTH_M / 2
    found = []
    for nosing in estimate.nosings:
        front = nosing.distance_m * ahead + np.array([0.0, 0.0, nosing.height_m])
        corners = [front - side, front + side]
        if nosing.tread_m is not None:
            back = front + nosing.tread_m * ahead
            corners += [back + side, back - side, front - side]
        found.append(np.array(corners))
        if nosing.riser_m is not None and estimate.direction > 0:
            foot = np.array([0.0, 0.0, -nosing.riser_m])
            found.append(np.array([front - side, front - side + foot, front + side + foot, front + side]))
    return found
