"""The RGB-D camera as a robot has it: reading, then corruption, then rate and latency."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stair_env.common.constants import CAMERA_MODES, DEPTH_SOURCES
from stair_env.common.validation import JsonSpec, SpecError, check_choice, check_range
from stair_env.intrinsics import D435I_COLOR_MODES, Intrinsics
from stair_env.scene.shapes import Shape
from stair_env.sensors.camera.colour_error import ColourErrorConfig, ColourErrorModel
from stair_env.sensors.camera.depth_error import DepthErrorConfig, DepthErrorModel
from stair_env.sensors.camera.image_motion import image_motion_px, middle_distance_m, motion_between
from stair_env.sensors.camera.renderers.base import Renderer
from stair_env.sensors.camera.renderers.factory import RENDERERS
from stair_env.sensors.camera.stereo import StereoConfig, StereoDepth

PRESETS: tuple[str, ...] = ("d435i", "ideal")
MovingShapes = Sequence[Shape] | Callable[[], Sequence[Shape]]

_TIME_TOLERANCE_S = 1e-6  # sums of control steps miss the frame grid by rounding
_STANDING_PX = 0.5  # image motion between frames below which matching windows still hold the same


@dataclass(frozen=True)
class CameraConfig(JsonSpec):
    """A D435i and how it sits on the robot.

    Args:
        mode: colour mode, "640x480", "848x480" or "1280x720"; depth is aligned to it.
        width: width to which the mode's image is scaled, keeping its shape; None for the mode's own. 512 is what
            the detector sees of any mode, and renders faster than 640.
        renderer: name of the renderer that whoever builds the camera makes: "raycast", "tiny" or "egl".
        rate_hz: frames per second (10 to 30 on robots; the device reaches 90).
        latency_s: from capture until the frame is available (80 to 140 ms on robots).
        latency_jitter_s: each frame's latency is drawn evenly within plus and minus this.
        depth: "model" applies `depth_error` to exact depth and is fast; "stereo" renders the infrared pair and matches
            it as `stereo` says, which is what real depth looks like and takes six to nine times as long.
        depth_error: errors of the modelled depth.
        stereo: the matched depth's camera.
        colour_error: errors of the colour image.
        near_m, far_m: what the ideal camera sees outside reads 0, metres.
        mount_offset_m: camera from where its calibration says, in its own axes (right, down, forward), metres.
        mount_rotation_rad: likewise, rotation vector about its own axes (pitch up, yaw right, roll clockwise).
        mount_offset_range_m, mount_rotation_range_rad: `reset` adds a draw within plus and minus this to each part.

    Raises:
        SpecError: a field is out of range (a ValueError).
    """

    mode: str = "640x480"
    width: int | None = None
    renderer: str = "raycast"
    rate_hz: float = 15.0
    latency_s: float = 0.1
    latency_jitter_s: float = 0.0
    depth: str = "model"
    depth_error: DepthErrorConfig = field(default_factory=DepthErrorConfig)
    stereo: StereoConfig = field(default_factory=StereoConfig)
    colour_error: ColourErrorConfig = field(default_factory=ColourErrorConfig)
    near_m: float = 0.05
    far_m: float = 20.0
    mount_offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount_rotation_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount_offset_range_m: float = 0.0
    mount_rotation_range_rad: float = 0.0

    def __post_init__(self) -> None:
        check_choice("mode", self.mode, CAMERA_MODES)
        check_choice("renderer", self.renderer, RENDERERS)
        self._check_width()
        check_range("rate_hz", self.rate_hz, 0.1, 90.0)
        check_range("latency_s", self.latency_s, 0.0, 2.0)
        check_range("latency_jitter_s", self.latency_jitter_s, 0.0, float(self.latency_s))
        check_choice("depth", self.depth, DEPTH_SOURCES)
        if not isinstance(self.stereo, StereoConfig):
            raise SpecError(f"stereo={self.stereo!r} must be a StereoConfig (from_dict takes an object)")
        if not isinstance(self.depth_error, DepthErrorConfig):
            raise SpecError(
                f"depth_error={self.depth_error!r} must be a DepthErrorConfig (from_dict takes preset names)"
            )
        if not isinstance(self.colour_error, ColourErrorConfig):
            raise SpecError(
                f"colour_error={self.colour_error!r} must be a ColourErrorConfig (from_dict takes preset names)"
            )
        check_range("near_m", self.near_m, 0.0, 5.0)
        check_range("far_m", self.far_m, 0.1, 1000.0)
        if self.near_m >= self.far_m:
            raise SpecError(f"near_m={self.near_m!r} must be below far_m={self.far_m!r}")
        self._check_vector("mount_offset_m", 0.5)
        self._check_vector("mount_rotation_rad", 3.2)
        check_range("mount_offset_range_m", self.mount_offset_range_m, 0.0, 0.2)
        check_range("mount_rotation_range_rad", self.mount_rotation_range_rad, 0.0, 0.5)

    def _check_width(self) -> None:
        if self.width is None:
            return
        if isinstance(self.width, bool) or not isinstance(self.width, (int, np.integer)):
            raise SpecError(f"width={self.width!r} must be a whole number of pixels or None")
        check_range("width", int(self.width), 32, D435I_COLOR_MODES[self.mode].width)

    def _check_vector(self, name: str, bound: float) -> None:
        values = getattr(self, name)
        if not isinstance(values, (tuple, list, np.ndarray)) or len(values) != 3:
            raise SpecError(f"{name}={values!r} must be three numbers (x right, y down, z forward)")
        for value in values:
            check_range(name, value, -bound, bound)
        object.__setattr__(self, name, tuple(float(value) for value in values))

    @property
    def intrinsics(self) -> Intrinsics:
        """Of the images that the camera delivers."""
        full = D435I_COLOR_MODES[self.mode]
        if self.width is None or self.width == full.width:
            return full
        return full.scaled(int(self.width), round(full.height * int(self.width) / full.width))

    @classmethod
    def preset(cls, name: str) -> CameraConfig:
        """A whole camera by name: "d435i", or "ideal" with neither errors nor latency.

        Raises:
            SpecError: no such preset.
        """
        check_choice("camera", name, PRESETS)
        if name == "ideal":
            return cls(latency_s=0.0, depth_error=DepthErrorConfig.ideal(), colour_error=ColourErrorConfig.ideal())
        return cls()

    @classmethod
    def from_dict(cls, values: Any) -> CameraConfig:
        """Build from JSON: None, a preset's name, or an object that names the fields to change.

        `depth_error` and `colour_error` may themselves be a preset's name ("d435i", "ideal") or an object. The field
        "preset" names what the others change; without it that is "d435i".

        Raises:
            SpecError: an unknown name or a wrong value; the message names the choices.
        """
        if values is None:
            return cls()
        if isinstance(values, str):
            return cls.preset(values)
        if not isinstance(values, dict):
            raise SpecError(
                f"camera={values!r} must be a preset ({', '.join(PRESETS)}) or a dict of CameraConfig fields"
            )
        fields = dict(values)
        base = cls.preset(fields.pop("preset", "d435i"))
        for name in fields:
            check_choice("camera field", name, ("preset", *(entry.name for entry in dataclasses.fields(cls))))
        if "depth_error" in fields:
            fields["depth_error"] = _error_config("depth_error", fields["depth_error"], DepthErrorConfig)
        if isinstance(fields.get("stereo"), dict):
            fields["stereo"] = StereoConfig.from_dict(fields["stereo"])
        if "colour_error" in fields:
            fields["colour_error"] = _error_config("colour_error", fields["colour_error"], ColourErrorConfig)
        return dataclasses.replace(base, **fields)


def _error_config(name: str, value: Any, kind: Any) -> Any:
    """A DepthErrorConfig or ColourErrorConfig from a preset's name, an object, or itself."""
    if isinstance(value, kind):
        return value
    if isinstance(value, dict):
        return kind.from_dict(value)
    check_choice(name, value, PRESETS)
    return kind.ideal() if value == "ideal" else kind()


@dataclass(frozen=True, eq=False)
class RgbdReading:
    """A frame as the robot's computer receives it.

    Attributes:
        rgb: uint8 (H, W, 3).
        depth_m: float32 (H, W), distance along the optical axis of the colour camera, metres; 0 = no reading.
        captured_at_s: when the shutter closed, in the clock of `RgbdCamera.step`.
        frame_index: frames captured before it since `reset`.
    """

    rgb: np.ndarray
    depth_m: np.ndarray
    captured_at_s: float
    frame_index: int


class RgbdCamera:
    """Delivers frames of a renderer as late and as damaged as a D435i does.

    The stream is running when an episode begins: the first `step` after `reset` captures a frame and delivers it at
    once. From there frames are captured on a grid of `rate_hz` and delivered `latency_s` later; between deliveries
    the last one stays available. A step longer than a frame period captures one frame, the newest.

    Args:
        config: the camera.
        renderer: draws the scene; stays its owner's.
        rng: draws mount, unit and noise; one number is taken from it at each `reset`.
    """

    def __init__(self, config: CameraConfig, renderer: Renderer, rng: np.random.Generator) -> None:
        self.config = config
        self.intrinsics = config.intrinsics
        self._depth_error = DepthErrorModel(config.depth_error)
        self._stereo = StereoDepth(config.stereo) if config.depth == "stereo" else None
        self._colour_error = ColourErrorModel(config.colour_error)
        self.reset(rng, renderer)

    def reset(self, rng: np.random.Generator, renderer: Renderer | None = None) -> None:
        """Begin an episode: forget frames, draw another unit and mount.

        Args:
            rng: one number is taken from it.
            renderer: of the new scene; None keeps the present one.
        """
        if renderer is not None:
            self._renderer = renderer
        self._rng = np.random.default_rng(int(rng.integers(2**63)))
        self._depth_error.reset(self._rng)
        self._colour_error.reset(self._rng)
        if self._stereo is not None:
            self._stereo.reset(self._rng)
        self._mount_error = draw_mount_error(self.config, self._rng)
        self._waiting: deque[tuple[float, RgbdReading]] = deque()
        self._delivered: RgbdReading | None = None
        self._last: tuple[float, np.ndarray] | None = None
        self._pose_of_frame: np.ndarray | None = None
        self._first_due_s = 0.0
        self._periods = 0
        self._captured = 0

    @property
    def mount_error(self) -> np.ndarray:
        """(4, 4) pose of the true camera in the frame of the camera that calibration believes in."""
        return self._mount_error.copy()

    @property
    def depth_scale_bias(self) -> float:
        """Relative depth error of the present unit."""
        return self._depth_error.scale_bias

    def step(self, time_s: float, camera_to_world: np.ndarray, moving_shapes: MovingShapes = ()) -> RgbdReading:
        """Advance the camera's clock.

        Args:
            time_s: now, seconds; any origin, not before the last call's.
            camera_to_world: (4, 4) pose of the optical frame according to the calibration.
            moving_shapes: solids in the world besides the renderer's scene, or a function that returns them; it is
                called only when a frame is captured.

        Returns:
            The newest frame that has arrived.

        Raises:
            ValueError: time runs backwards or the pose has a wrong shape.
        """
        pose = np.asarray(camera_to_world, dtype=np.float64)
        if pose.shape != (4, 4):
            raise ValueError(f"camera_to_world has shape {pose.shape}, must be (4, 4)")
        last_s = self._last[0] if self._last is not None else -np.inf
        if not time_s >= last_s:  # written so that NaN fails too
            raise ValueError(f"time_s={time_s!r} must not lie before the last step's {last_s!r}")
        pose = pose @ self._mount_error
        if self._is_due(time_s):
            reading = self._capture(time_s, pose, moving_shapes)
            self._waiting.append((time_s + self._draw_latency(), reading))
        self._last = (time_s, pose)
        return self._deliver(time_s)

    def _is_due(self, time_s: float) -> bool:
        """Whether a frame is due; if so, move the grid past now."""
        if self._last is None:
            self._first_due_s, self._periods = time_s, 1
            return True
        elapsed = (time_s - self._first_due_s + _TIME_TOLERANCE_S) * self.config.rate_hz
        if elapsed < self._periods:
            return False
        self._periods = int(elapsed) + 1
        return True

    def _capture(self, time_s: float, pose: np.ndarray, moving_shapes: MovingShapes) -> RgbdReading:
        from stair_env.sensors.camera.renderers.threads import later

        moving = moving_shapes() if callable(moving_shapes) else moving_shapes
        frame = self._renderer.render(self.intrinsics, pose, moving=moving)
        depth = np.asarray(frame.depth_m, dtype=np.float32)
        distance_m = middle_distance_m(depth, self.config.near_m, self.config.far_m)
        motion = self._pixel_motion(time_s, pose, frame.rgb, distance_m)
        colour_work = self._colour_error.begin(frame.rgb, self._rng, motion)
        depth_work = self._begin_depth(pose, moving, depth, frame.rgb, distance_m)
        rgb = later(colour_work)
        reading = RgbdReading(depth_m=depth_work(), rgb=rgb(), captured_at_s=time_s, frame_index=self._captured)
        self._captured += 1
        return reading

    def _begin_depth(
        self, pose: np.ndarray, moving: Sequence[Shape], depth_m: np.ndarray, rgb: np.ndarray, distance_m: float
    ) -> Callable[[], np.ndarray]:
        """Draw what the depth needs of chance; the function that is returned makes the image."""
        stereo = self._stereo
        if stereo is None:
            standing = self._is_standing(pose, distance_m)
            seen_m = self.config.near_m, self.config.far_m
            return self._depth_error.begin(depth_m, rgb, self.intrinsics, self._rng, standing, seen_m)
        left, right = stereo.infrared_pair(self._renderer, pose, self._rng, moving)
        return lambda: stereo.depth_of_pair(left, right, self.intrinsics)

    def _is_standing(self, pose: np.ndarray, distance_m: float) -> bool:
        """Whether the image has moved less than `_STANDING_PX` since the last frame that counted as another view."""
        if self._pose_of_frame is not None:
            turn_rad, moved_m = motion_between(self._pose_of_frame, pose)
            if self.intrinsics.fx * (turn_rad + moved_m / distance_m) < _STANDING_PX:
                return True
        self._pose_of_frame = pose
        return False

    def _pixel_motion(self, time_s: float, pose: np.ndarray, rgb: np.ndarray, distance_m: float) -> np.ndarray | None:
        """(2,) image motion while the shutter is open, None when nothing is known about it."""
        if self._last is None or time_s <= self._last[0] or not self.config.colour_error.motion_blur:
            return None
        exposure_s = self._colour_error.exposure_s(rgb)
        moved = image_motion_px(self.intrinsics, self._last[1], pose, distance_m)
        return moved * (exposure_s / (time_s - self._last[0]))

    def _draw_latency(self) -> float:
        jitter = self.config.latency_jitter_s
        return self.config.latency_s + float(self._rng.uniform(-jitter, jitter))

    def _deliver(self, time_s: float) -> RgbdReading:
        if self._delivered is None:
            self._delivered = self._waiting.popleft()[1]
        while self._waiting and self._waiting[0][0] <= time_s + _TIME_TOLERANCE_S:
            self._delivered = self._waiting.popleft()[1]
        return self._delivered


def draw_mount_error(config: CameraConfig, rng: np.random.Generator) -> np.ndarray:
    """Draw how far the camera sits from where its calibration says.

    Args:
        config: fixed offsets and ranges.
        rng: six numbers are drawn, whatever the ranges.

    Returns:
        (4, 4) float64, pose of the true camera in the frame of the believed one.
    """
    drawn = rng.uniform(-1.0, 1.0, 6)
    error = np.eye(4)
    rotation = np.asarray(config.mount_rotation_rad) + config.mount_rotation_range_rad * drawn[:3]
    error[:3, :3] = Rotation.from_rotvec(rotation).as_matrix()
    error[:3, 3] = np.asarray(config.mount_offset_m) + config.mount_offset_range_m * drawn[3:]
    return error
