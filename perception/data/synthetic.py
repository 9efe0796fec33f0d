"""Labelled RGB-D frames of random staircases, drawn by the simulator's camera.

One generator decides everything about a frame: scene, light, viewpoint, camera mode, sensor errors. Frames are
letterboxed to 512 x 512 as the network sees them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from perception.inference.preprocess import letterbox, letterbox_lines
from stair_env.common.constants import IMAGE_SIZE, NOMINAL_GRAVITY_M_S2
from stair_env.common.field_kinds import naming_fields
from stair_env.common.validation import check_choice, check_range
from stair_env.intrinsics import D435I_COLOR_MODES, Intrinsics
from stair_env.sampling import SceneSampler, sample_camera_pose
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.labels import LineLabel
from stair_env.sensors.camera.still import draw_device, draw_labelled, draw_matched

MOTION_SHARE = 0.3  # of the frames are taken while the camera moves
MOTION_STD_PX = 2.0  # a trotting robot's 0.3 rad/s over 8 ms at f = 615 px is 1.5 px
CLUTTER_SHARE = 0.12  # of the scenes have people or things on the flight
VIEWS: tuple[str, ...] = ("ascending", "descending", "none")


@dataclass(frozen=True)
class FrameConfig:
    """What kind of frames are drawn.

    Args:
        sampler: scenes; by default day and night alike, all directions, 9 % without stairs.
        mode_shares: camera mode -> share of the frames.
        direct_share: share of frames that the camera delivers 512 pixels wide already, as `CameraConfig.width` allows;
            the others are drawn in the mode's own size and scaled.
        robot_share: share of viewpoints on a robot's head; the others are hand-held.
        sensor_errors: whether depth and colour carry a D435i's errors.
        stereo_variants: how many further depth images a frame gets, each matched from an infrared pair of a random
            unit with random settings (`StereoConfig.random`).

    Raises:
        SpecError: a share is negative or a mode unknown (a ValueError).
    """

    sampler: SceneSampler = field(default_factory=lambda: SceneSampler(negatives=0.09, clutter=CLUTTER_SHARE))
    mode_shares: Mapping[str, float] = field(default_factory=lambda: {"640x480": 0.75, "848x480": 0.25})
    direct_share: float = 0.5
    robot_share: float = 0.5
    sensor_errors: bool = True
    stereo_variants: int = 0

    @naming_fields
    def __post_init__(self) -> None:
        check_range("stereo_variants", self.stereo_variants, 0, 9)
        check_range("robot_share", self.robot_share, 0.0, 1.0)
        check_range("direct_share", self.direct_share, 0.0, 1.0)
        for mode, share in self.mode_shares.items():
            check_choice("camera mode", mode, tuple(D435I_COLOR_MODES))
            check_range(f"share of {mode}", share, 0.0, 1.0)
        check_range("sum of mode_shares", sum(self.mode_shares.values()), 1.0 - 1e-9, 1.0 + 1e-9)


@dataclass(frozen=True)
class LabelledFrame:
    """One frame as a data set holds it.

    Attributes:
        rgb: uint8 (512, 512, 3).
        depth_m: float32 (512, 512), metres, 0 = no reading.
        kinds: (n,) int64, 0 convex, 1 concave.
        lines: (n, 4) float64, pixels of the 512 x 512 image, left end first.
        view: "ascending", "descending", or "none" when no line is in view.
        lighting: "day" or "night".
        intrinsics: of the 512 x 512 image.
        gravity: (3,) accelerometer reading at rest, camera frame, m/s^2.
        camera_to_world: (4, 4).
        scene: what was drawn.
        stereo_m: depth images like depth_m, matched from infrared pairs.
    """

    rgb: np.ndarray
    depth_m: np.ndarray
    kinds: np.ndarray
    lines: np.ndarray
    view: str
    lighting: str
    intrinsics: Intrinsics
    gravity: np.ndarray
    camera_to_world: np.ndarray
    scene: SceneSpec
    stereo_m: tuple[np.ndarray, ...] = ()

    def side_car(self) -> dict[str, Any]:
        """What is written beside the image: intrinsics and gravity for `stair-env perceive`, and the truth."""
        stairs = self.scene.stairs
        return {
            **{name: getattr(self.intrinsics, name) for name in ("fx", "fy", "cx", "cy")},
            "gravity": self.gravity.tolist(),
            "depth_scale": DEPTH_UNIT_M,
            "lighting": self.lighting,
            "view": self.view,
            "camera_to_world": self.camera_to_world.tolist(),
            "truth": None
            if stairs is None
            else {"step_width_m": stairs.tread_depth, "step_height_m": stairs.riser_height, "steps": stairs.num_steps},
            "scene": json.loads(self.scene.to_json()),
        }


DEPTH_UNIT_M = 0.001  # 16-bit png in millimetres, RealSense's unit


def draw_frame(rng: np.random.Generator, config: FrameConfig, threads: int | None = None) -> LabelledFrame:
    """Draw a random scene from a random viewpoint.

    Args:
        rng: the source of all chance.
        config: what kind of frames.
        threads: of the ray caster; None for its default.
    """
    spec = config.sampler.sample(rng)
    scene = Scene(spec)
    pose = sample_camera_pose(spec, rng, robot_share=config.robot_share, scene=scene)
    modes = list(config.mode_shares)
    chosen = modes[int(rng.choice(len(modes), p=[config.mode_shares[mode] for mode in modes]))]
    intrinsics = D435I_COLOR_MODES[chosen]
    if rng.random() < config.direct_share:
        intrinsics = intrinsics.scaled(IMAGE_SIZE, round(intrinsics.height * IMAGE_SIZE / intrinsics.width))
    return photograph(
        scene,
        pose,
        intrinsics,
        rng,
        sensor_errors=config.sensor_errors,
        stereo_variants=config.stereo_variants,
        threads=threads,
    )


def photograph(
    scene: Scene,
    camera_to_world: np.ndarray,
    intrinsics: Intrinsics,
    rng: np.random.Generator,
    *,
    sensor_errors: bool = True,
    stereo_variants: int = 0,
    threads: int | None = None,
) -> LabelledFrame:
    """Draw one scene from one viewpoint and label it.

    Args:
        scene: what to draw.
        camera_to_world: (4, 4) pose of the optical frame.
        intrinsics: of the camera; the result is letterboxed from this image.
        rng: draws the sensor's errors.
        sensor_errors: whether to apply them.
        stereo_variants: see `FrameConfig`.
        threads: of the ray caster.
    """
    scale = max(intrinsics.width, intrinsics.height) / IMAGE_SIZE  # camera pixels per pixel of the result
    frame, labels = draw_labelled(scene, intrinsics, camera_to_world, label_scale=scale, threads=threads)
    rgb, depth_m = frame.rgb, frame.depth_m
    if sensor_errors:
        rgb, depth_m = corrupt(rgb, depth_m, intrinsics, rng)
    matched = draw_matched(scene, intrinsics, camera_to_world, rng, stereo_variants, threads=threads)
    square_rgb, depth_m = letterbox(rgb, depth_m)
    lines = np.array([(label.x1, label.y1, label.x2, label.y2) for label in labels]).reshape(-1, 4)
    return LabelledFrame(
        rgb=square_rgb,
        depth_m=depth_m,
        kinds=np.array([label.class_id for label in labels], dtype=np.int64),
        lines=letterbox_lines(lines, intrinsics.width, intrinsics.height),
        view=view_of(scene, labels),
        lighting=scene.spec.appearance.lighting,
        intrinsics=intrinsics.letterboxed(IMAGE_SIZE),
        gravity=NOMINAL_GRAVITY_M_S2 * camera_to_world[2, :3],
        camera_to_world=camera_to_world,
        scene=scene.spec,
        stereo_m=tuple(letterbox(rgb, depth)[1] for depth in matched),
    )


def corrupt(
    rgb: np.ndarray, depth_m: np.ndarray, intrinsics: Intrinsics, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A clean frame as one random D435i reports it: colour uint8 (H, W, 3), depth float32 (H, W) metres."""
    depth_model, colour_model = draw_device(rng)
    depth = depth_model.apply(depth_m, rgb, intrinsics, rng)
    moves = rng.random() < MOTION_SHARE
    motion = rng.normal(0.0, MOTION_STD_PX, 2) * moves
    return colour_model.apply(rgb, rng, motion), depth


def view_of(scene: Scene, labels: list[LineLabel]) -> str:
    """Which way the nearest staircase in view leads: "ascending", "descending", or "none" without lines.

    The lowest labelled line in the image decides, since a staircase up and down shows both flights.
    """
    stairs = scene.spec.stairs
    if stairs is None or not labels:
        return "none"
    nearest = max(labels, key=lambda label: label.y1 + label.y2)
    return "ascending" if stairs.profile().rises[nearest.step] > 0 else "descending"
