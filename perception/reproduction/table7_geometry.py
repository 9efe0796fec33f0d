"""The paper's table 7: step width and height of six staircases, measured and true (docs/measuring.md).

Every staircase is photographed from random poses by day and by night, going up and going down, through the errors of
a D435i and its IMU. Every frame that shows one of the three nearest steps is one measurement of it; the root mean
square errors are over all of them, nothing averaged first. The paper's own fit, an uncalibrated depth scale, and the
level planes of the point cloud without any lines are measured on the same frames.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np

from perception.estimator import StairEstimator
from perception.geometry.results import StairEstimate
from perception.reproduction.ideal_detector import IdealDetector
from perception.reproduction.point_planes import measure_point_planes
from stair_env.common.constants import BACKENDS, DEPTH_SOURCES, MEASURED_DETECTORS, NOMINAL_GRAVITY_M_S2
from stair_env.common.transforms import look_along
from stair_env.common.validation import check_choice, check_range
from stair_env.intrinsics import D435I_COLOR_MODES, Intrinsics
from stair_env.sampling import SceneSampler
from stair_env.scene.paper_stairs import PAPER_STAIRS, PaperStair
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.depth_error import DepthErrorConfig
from stair_env.sensors.camera.labels import LineLabel, visible_edges
from stair_env.sensors.camera.renderers.base import Frame
from stair_env.sensors.camera.renderers.factory import make_renderer
from stair_env.sensors.camera.stereo import StereoConfig
from stair_env.sensors.camera.still import draw_device, draw_matched
from stair_env.sensors.imu import Imu, ImuConfig
from stair_env.stairs import StairProfile, StairSpec, WalkingDirection

DIRECTION_WORDS: dict[WalkingDirection, str] = {"up": "ascending", "down": "descending"}
MEASURED_STEPS = 3  # the paper evaluates the three steps nearest to the camera
DISTANCE_M = (0.6, 1.8)  # from the first line, horizontally
HEIGHT_M = (0.45, 1.4)  # of the lens above the floor: a robot's head to a hand
PITCH_RAD = ROLL_RAD = math.radians(5.0)  # about looking at the middle of the three steps, and about level
YAW_RAD = math.radians(20.0)
SIGHT_MARGIN = 1.1  # going down, the line of sight is at least this much steeper than the stairs
EDGE_MARGIN_PX = 8.0  # of a line from the upper and lower edge of the image, for the pose to count
POSE_TRIES = 400
SHOT_TRIES = 100
PAPER_RMSE_MM = {"ascending": (6.29, 14.23), "descending": (24.82, 11.40)}  # last row of its table 7
SCALE_BIAS = 0.005  # a calibrated unit
SCALE_BIAS_UNCALIBRATED = 0.02  # data sheet
IMU_SAMPLES = 60  # a quarter of a second at rest
IDEAL_JITTER_PX = 0.8  # of an end point; what is left of a line after clustering is far less


class SupportsProgress(Protocol):
    """Called once a frame."""

    def __call__(self) -> Any:
        """One frame is done."""


@dataclass(frozen=True)
class MeasureConfig:
    """What is measured.

    Args:
        network: "stairnet", or "ideal" for true lines with a detector's jitter: the floor of the geometry.
        width: of StairNetV2.
        poses: per staircase, direction and lighting.
        mode: D435i colour mode.
        stairs: which of the paper's staircases.
        backend: of the network, one of `perception.inference.backends.BACKENDS`.
        depth: "model", a D435i's errors put on exact depth, or "stereo", a matched infrared pair.

    Raises:
        SpecError: a field is out of range (a ValueError).
    """

    network: Literal["stairnet", "ideal"] = "stairnet"
    width: float = 0.5
    poses: int = 50
    mode: str = "640x480"
    stairs: tuple[PaperStair, ...] = PAPER_STAIRS
    backend: str = "onnx"
    depth: str = "model"

    def __post_init__(self) -> None:
        check_choice("depth", self.depth, DEPTH_SOURCES)
        check_choice("network", self.network, MEASURED_DETECTORS)
        check_choice("backend", self.backend, BACKENDS)
        check_choice("mode", self.mode, tuple(D435I_COLOR_MODES))
        check_range("poses", self.poses, 1, 100_000)

    @property
    def frames(self) -> int:
        """How many frames will be drawn."""
        return len(self.stairs) * len(DIRECTION_WORDS) * 2 * self.poses


@dataclass(frozen=True)
class Shot:
    """One corrupted frame and what is true of it.

    Attributes:
        rgb: uint8 (H, W, 3).
        depth_m: float32 (H, W), of a unit with a scale bias within 0.5 %.
        depth_uncalibrated_m: the same through a unit with a scale bias within 2 %.
        intrinsics: of both.
        gravity: (3,) mean accelerometer reading at rest, camera frame, m/s^2.
        labels: visible stair lines.
        camera_x: of the lens along the walking direction, stair frame, metres.
        yaw_rad: heading of the lens relative to the stairs, positive to the right.
    """

    rgb: np.ndarray
    depth_m: np.ndarray
    depth_uncalibrated_m: np.ndarray
    intrinsics: Intrinsics
    gravity: np.ndarray
    labels: list[LineLabel]
    camera_x: float
    yaw_rad: float


@dataclass
class Errors:
    """Measured minus true, per way of measuring; rows of (width, height) in millimetres."""

    measured_mm: dict[tuple[str, int], list[tuple[float, float]]] = field(default_factory=lambda: defaultdict(list))
    error_mm: list[tuple[float, float]] = field(default_factory=list)
    possible: int = 0

    def rmse_mm(self) -> list[float]:
        """Root mean square errors [width, height]; zeros when nothing was measured."""
        if not self.error_mm:
            return [0.0, 0.0]
        return [round(float(value), 2) for value in np.sqrt(np.mean(np.square(self.error_mm), axis=0))]

    def coverage(self) -> float:
        """Share of the steps in view that were measured."""
        return round(len(self.error_mm) / max(self.possible, 1), 4)


def draw_pose(spec: StairSpec, rng: np.random.Generator, intrinsics: Intrinsics) -> np.ndarray:
    """A camera that has the lines of the three nearest steps in its picture.

    Args:
        spec: the staircase, up or down.
        rng: the source of all chance.
        intrinsics: of the camera.

    Returns:
        (4, 4) camera_to_world. Distance, yaw, roll and pitch are drawn as the module's constants say; the height of
        the lens is drawn so that the steps are in sight, which going down means above the slope of the stairs.

    Raises:
        ValueError: no such place is found.
    """
    profile = spec.profile()
    floor, middle_x = float(profile.level_z[0]), float(profile.edge_x[1] + profile.edge_x[2]) / 2.0
    for _ in range(POSE_TRIES):
        distance = float(rng.uniform(*DISTANCE_M))
        lowest = HEIGHT_M[0]
        if spec.direction == "down":
            lowest = max(lowest, SIGHT_MARGIN * distance * math.tan(spec.slope_rad))
        height = float(rng.uniform(lowest, max(HEIGHT_M[1], lowest)))
        yaw, roll = float(rng.uniform(-YAW_RAD, YAW_RAD)), float(rng.uniform(-ROLL_RAD, ROLL_RAD))
        target_z = float(profile.height_at(middle_x)) - floor
        pitch = math.atan2(height - target_z, distance + middle_x) + float(rng.uniform(-PITCH_RAD, PITCH_RAD))
        y = -math.tan(yaw) * (distance + middle_x)
        pose = look_along(np.array([-distance, y, floor + height]), yaw, pitch, roll)
        if _steps_in_view(profile, spec.direction == "up", pose, intrinsics):
            return pose
    raise ValueError(f"found no pose with the {MEASURED_STEPS} nearest steps of {spec} in view")


def _steps_in_view(profile: StairProfile, ascending: bool, pose: np.ndarray, intrinsics: Intrinsics) -> bool:
    """Whether the middles of all lines that bound the measured steps are in the picture."""
    x = profile.edge_x[: MEASURED_STEPS + 1]
    z = profile.level_z[: MEASURED_STEPS + 1]  # inner edges going up, nosings going down
    points = np.stack([x, np.zeros_like(x), z], axis=1)
    if ascending:
        points = np.concatenate([points, points[:-1] + [[0.0, 0.0, rise] for rise in profile.rises[:MEASURED_STEPS]]])
    uv = intrinsics.project((points - pose[:3, 3]) @ pose[:3, :3])
    inside = (uv[:, 0] > 0.0) & (uv[:, 0] < intrinsics.width)
    inside &= (uv[:, 1] > EDGE_MARGIN_PX) & (uv[:, 1] < intrinsics.height - EDGE_MARGIN_PX)
    return bool(inside.all())  # NaN, behind the camera, compares false


def photograph(
    spec: StairSpec, scene: Scene, rng: np.random.Generator, intrinsics: Intrinsics, stereo: StereoConfig | None = None
) -> Shot:
    """One frame of a scene from a random pose, with the errors of one random D435i; with `stereo`, of such a camera.

    Raises:
        ValueError: no pose is found from which every line of the measured steps is seen.
    """
    pose, frame, labels = _frame_with_steps(spec, scene, rng, intrinsics)
    depth_model, colour_model = draw_device(rng, DepthErrorConfig(scale_bias_range=SCALE_BIAS))
    depth = depth_model.apply(frame.depth_m, frame.rgb, intrinsics, rng)
    if stereo is not None:
        matched = draw_matched(scene, intrinsics, pose, rng, config=stereo)[0]
        depth = matched * np.float32(1.0 + depth_model.scale_bias)
    other_scale = (1.0 + rng.uniform(-1.0, 1.0) * SCALE_BIAS_UNCALIBRATED) / (1.0 + depth_model.scale_bias)
    still = np.tile(NOMINAL_GRAVITY_M_S2 * pose[2, :3], (IMU_SAMPLES, 1))
    force, _ = Imu(ImuConfig(), rng).read_many(still, np.zeros_like(still))
    forward = pose[:3, 2]
    return Shot(
        rgb=colour_model.apply(frame.rgb, rng),
        depth_m=depth,
        depth_uncalibrated_m=(depth * np.float32(other_scale)).astype(np.float32),
        intrinsics=intrinsics,
        gravity=force.mean(axis=0),
        labels=labels,
        camera_x=float(pose[0, 3]),
        yaw_rad=-math.atan2(float(forward[1]), float(forward[0])),
    )


def _frame_with_steps(
    spec: StairSpec, scene: Scene, rng: np.random.Generator, intrinsics: Intrinsics
) -> tuple[np.ndarray, Frame, list[LineLabel]]:
    """Pose, frame and labels; every line that bounds the measured steps is in view, clear of its neighbours."""
    steps = range(MEASURED_STEPS)
    needed = {("convex", step) for step in steps}
    needed |= {("concave", step) for step in steps} if spec.direction == "up" else {("convex", MEASURED_STEPS)}
    renderer = make_renderer("raycast", scene)
    try:
        for _ in range(SHOT_TRIES):
            pose = draw_pose(spec, rng, intrinsics)
            frame = renderer.render(intrinsics, pose)
            labels = visible_edges(scene.edges, intrinsics, pose, frame)
            if needed <= {(label.kind, label.step) for label in labels}:
                return pose, frame, labels
    finally:
        renderer.close()
    raise ValueError(f"found no pose with every line of the {MEASURED_STEPS} nearest steps of {spec} in view")


def dress(spec: StairSpec, lighting: Literal["day", "night"], rng: np.random.Generator) -> SceneSpec:
    """The staircase with random materials, light and surroundings."""
    sampler = SceneSampler(
        riser_height=spec.riser_height,
        tread_depth=spec.tread_depth,
        num_steps=spec.num_steps,
        direction=spec.direction,
        lighting=lighting,
        distractors=False,
        details=False,
    )
    drawn = sampler.sample(rng)
    return SceneSpec(spec, drawn.appearance, (), drawn.surroundings)


def steps_of(estimate: StairEstimate, profile: StairProfile, camera_x: float) -> Iterator[tuple[int, float, float]]:
    """(index, width, height) in metres of each measured step that is one of the three nearest.

    A step is the true one whose nosing is nearest to the measured, if within half a tread.
    """
    runs = np.diff(profile.edge_x)
    for step in estimate.steps:
        offset = np.abs(profile.edge_x[:-1] - camera_x - step.distance_m)
        index = int(np.argmin(offset))
        if index < MEASURED_STEPS and offset[index] < runs[index] / 2.0:
            yield index, step.width_m, step.height_m


POINT_PLANES = "point cloud's planes"
TABLE_METHODS: tuple[str, ...] = ("planes", "paper", "planes, scale bias 2 %", POINT_PLANES)


class _Bench:
    """The estimators and what they made of the frames so far."""

    def __init__(self, config: MeasureConfig, rng: np.random.Generator) -> None:
        self.ideal = IdealDetector(IDEAL_JITTER_PX, rng=rng) if config.network == "ideal" else None
        first = StairEstimator(config.width, config.backend, detector=self.ideal)
        self.planes = first
        self.paper = StairEstimator(config.width, detector=self.ideal or first.detector, method="paper")
        self.errors: dict[tuple[str, str, str], Errors] = defaultdict(Errors)

    def take(self, shot: Shot, stair: PaperStair, spec: StairSpec, lighting: str) -> None:
        """Measure one frame in every way."""
        if self.ideal is not None:
            self.ideal.show(shot.labels, shot.intrinsics.width, shot.intrinsics.height)
        cls, loc = self.planes.detect(shot.rgb, shot.depth_m)
        ways = {
            TABLE_METHODS[0]: (self.planes, shot.depth_m),
            TABLE_METHODS[1]: (self.paper, shot.depth_m),
            TABLE_METHODS[2]: (self.planes, shot.depth_uncalibrated_m),
        }
        profile = spec.profile()
        estimates = {
            name: estimator.interpret(cls, loc, depth, shot.intrinsics, shot.gravity)
            for name, (estimator, depth) in ways.items()
        }
        estimates[POINT_PLANES] = measure_point_planes(shot.depth_m, shot.intrinsics, shot.gravity)
        for name, estimate in estimates.items():
            found = {index: (w, h) for index, w, h in steps_of(estimate, profile, shot.camera_x)}
            errors = self.errors[name, spec.direction, lighting]
            errors.possible += MEASURED_STEPS
            for index, (width, height) in found.items():
                true = stair.steps_mm[index]
                errors.measured_mm[stair.name, index].append((1000.0 * width, 1000.0 * height))
                errors.error_mm.append((1000.0 * width - true[0], 1000.0 * height - true[1]))


def run_measurement(config: MeasureConfig, seed: int, on_frame: SupportsProgress | None = None) -> dict[str, Any]:
    """Measure all staircases.

    Args:
        config: what is measured.
        seed: of every random draw.
        on_frame: called after each frame.

    Returns:
        JSON-able: `rows` (stair, step, direction, true_mm, measured_mm: mean, std_mm, frames, paper_fit_mm),
        `rmse_mm` {ascending, descending}: [width, height] over all single measurements, and the same under
        `rmse_mm_by` for each method and lighting, with `coverage`, the share of steps in view that were measured.
    """
    rng = np.random.default_rng(seed)
    stereo = StereoConfig() if config.depth == "stereo" else None
    bench = _Bench(config, np.random.default_rng(rng.integers(2**63)))
    intrinsics = D435I_COLOR_MODES[config.mode]
    lightings: tuple[Literal["day", "night"], ...] = ("day", "night")
    for stair in config.stairs:
        for direction in DIRECTION_WORDS:
            spec = stair.spec(direction)
            for lighting in lightings:
                for _ in range(config.poses):
                    scene = Scene(dress(spec, lighting, rng))
                    bench.take(photograph(spec, scene, rng, intrinsics, stereo), stair, spec, lighting)
                    if on_frame is not None:
                        on_frame()
    return _summary(config, bench)


def _summary(config: MeasureConfig, bench: _Bench) -> dict[str, Any]:
    merged: dict[tuple[str, str], Errors] = defaultdict(Errors)
    by: dict[str, dict[str, Any]] = {name: {} for name in TABLE_METHODS}
    for (name, direction, lighting), errors in bench.errors.items():
        word = DIRECTION_WORDS[direction]  # type: ignore[index]
        by[name][f"{word}, {lighting}"] = {"rmse_mm": errors.rmse_mm(), "coverage": errors.coverage()}
        total = merged[name, direction]
        total.possible += errors.possible
        total.error_mm.extend(errors.error_mm)
        for key, values in errors.measured_mm.items():
            total.measured_mm[key].extend(values)
    for (name, direction), errors in merged.items():
        word = DIRECTION_WORDS[direction]  # type: ignore[index]
        by[name][word] = {"rmse_mm": errors.rmse_mm(), "coverage": errors.coverage()}
    return {
        "network": config.network,
        "depth": config.depth,
        "width": config.width,
        "backend": config.backend,
        "poses": config.poses,
        "rows": list(_rows(config, merged)),
        "rmse_mm": {word: merged[TABLE_METHODS[0], direction].rmse_mm() for direction, word in DIRECTION_WORDS.items()},
        "rmse_mm_by": by,
        "overall": _overall(by),
    }


def _overall(by: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """A line per method and case, for tables, below the paper's own."""
    lines: dict[str, dict[str, Any]] = {
        f"paper, its own camera, {case}": {"width_rmse_mm": width, "height_rmse_mm": height}
        for case, (width, height) in PAPER_RMSE_MM.items()
    }
    for method, cases in by.items():
        for case, numbers in sorted(cases.items()):
            width, height = numbers["rmse_mm"]
            line = {"width_rmse_mm": width, "height_rmse_mm": height, "steps_measured": numbers["coverage"]}
            lines[f"{method}, {case}"] = line
    return lines


def _rows(config: MeasureConfig, merged: dict[tuple[str, str], Errors]) -> Iterator[dict[str, Any]]:
    for stair in config.stairs:
        for direction, word in DIRECTION_WORDS.items():
            for index, true in enumerate(stair.steps_mm):
                ours = np.array(merged[TABLE_METHODS[0], direction].measured_mm[stair.name, index]).reshape(-1, 2)
                paper = np.array(merged[TABLE_METHODS[1], direction].measured_mm[stair.name, index]).reshape(-1, 2)
                yield {
                    "stair": stair.name,
                    "step": index + 1,
                    "direction": word,
                    "true_mm": list(true),
                    "measured_mm": _rounded(ours.mean(axis=0)) if len(ours) else None,
                    "std_mm": _rounded(ours.std(axis=0)) if len(ours) else None,
                    "frames": len(ours),
                    "paper_fit_mm": _rounded(paper.mean(axis=0)) if len(paper) else None,
                    "paper_fit_frames": len(paper),
                }


def _rounded(values: np.ndarray) -> list[float]:
    return [round(float(value), 1) for value in values]
