"""The climbing environment with a D435i on the robot's head."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from stair_env.common.constants import GRAVITY_M_S2, PHYSICS_RATE_HZ, SUBSTEPS
from stair_env.env import StairClimbEnv
from stair_env.intrinsics import Intrinsics
from stair_env.observation import proprio_space
from stair_env.physics.body_state import base_to_world
from stair_env.physics.engines import check_renderer
from stair_env.physics.interface import Physics
from stair_env.robots import mount_to_base
from stair_env.sampling import Scene, SceneSampler
from stair_env.scene.shapes import Shape
from stair_env.sensors.camera.renderers import make_renderer
from stair_env.sensors.camera.renderers.bullet import load_egl
from stair_env.sensors.camera.sensor import CameraConfig, RgbdCamera, RgbdReading
from stair_env.sensors.camera.third_person import FollowCamera
from stair_env.sensors.imu import IMU_POSITION_IN_CAMERA_M, ImuConfig, MountedImu
from stair_env.stairs import StairSpec

IMU_BOUND = np.array([4 * GRAVITY_M_S2] * 3 + [np.radians(1000.0)] * 3, np.float32)  # BMI055 as set: ±4 g, ±1000 °/s
FAR_M = 65.535  # largest distance of a 16-bit depth image in millimetres


class StairClimbRgbdEnv(StairClimbEnv):
    """`StairClimbEnv` whose observation holds what the camera delivers instead of the stair block.

    Observation: Dict of
        `proprio`: as in `StairClimbEnv`;
        `imu`: (5, 6) float32, accelerometer (m/s²) and gyro (rad/s) in the camera's axes, the five samples since the
            last control step, oldest first;
        `rgb`: (H, W, 3) uint8, the newest frame that has arrived;
        `depth`: (H, W) float32 metres, aligned to colour, 0 = no reading;
        `privileged`: as in `StairClimbEnv`, where asked for.
    `info["camera"]` says when the frame was captured. The gait walks blind until somebody calls `provide_stair`.

    Args:
        camera: fields of `CameraConfig`, for example {"mode": "640x480", "renderer": "tiny", "depth_error": "ideal"}.
        kwargs: see `StairClimbEnv`; stair_source is "external" unless given.
    """

    def __init__(self, camera: dict[str, Any] | None = None, **kwargs: Any) -> None:
        kwargs.setdefault("stair_source", "external")
        self.camera_config = CameraConfig.from_dict(camera)  # the observation's space depends on it
        self.camera_intrinsics: Intrinsics = self.camera_config.intrinsics
        super().__init__(camera=camera, **kwargs)
        check_renderer(self.engine, self.camera_config.renderer)
        self._camera: RgbdCamera | None = None
        self._camera_to_base = mount_to_base(self.robot.camera)
        self._scene_sampler = SceneSampler(lighting=self.lighting)  # type: ignore[arg-type]

    def _sensed_spaces(self) -> dict[str, spaces.Space[Any]]:
        height, width = self.camera_intrinsics.height, self.camera_intrinsics.width
        bound = np.tile(IMU_BOUND, (SUBSTEPS, 1))
        return {
            "proprio": proprio_space(self.action_size),
            "imu": spaces.Box(-bound, bound, dtype=np.float32),
            "rgb": spaces.Box(0, 255, (height, width, 3), np.uint8),
            "depth": spaces.Box(0.0, FAR_M, (height, width), np.float32),
        }

    def _open_simulation(self, visible: bool = False) -> Physics:
        sim = super()._open_simulation(visible or self.camera_config.renderer != "raycast")
        if self.camera_config.renderer == "egl":
            load_egl(sim.client)
        return sim

    def _world_shapes(self, stairs: StairSpec, rng: np.random.Generator) -> tuple[Shape, ...]:
        self.scene = Scene(self._given_scene or self._scene_sampler.sample_around(stairs, rng))
        if self.camera_config.renderer == "raycast":
            return super()._world_shapes(stairs, rng)  # walls and furniture out of the way need no bodies
        return self.scene.shapes  # Bullet's renderers draw bodies

    def _surroundings(self) -> Scene:
        return self.scene

    def _begin_sensors(self, rng: np.random.Generator) -> None:
        sim = self._sim
        assert sim is not None
        renderer = make_renderer(self.camera_config.renderer, self.scene, sim.client)
        self._body_shapes = sim.solids()
        self._follower: FollowCamera | None = None
        tilt = self.randomization.camera_tilt_rad
        self._tilt = _rotation_about_x(float(rng.uniform(-tilt, tilt)))
        if self._camera is None:
            self._camera = RgbdCamera(self.camera_config, renderer, rng)
        else:
            self._camera.reset(rng, renderer)
        mount = self._camera_to_base @ self._tilt
        lever = mount[:3, :3] @ np.asarray(IMU_POSITION_IN_CAMERA_M) + mount[:3, 3]
        self._camera_imu = MountedImu(ImuConfig(), lever, mount[:3, :3], PHYSICS_RATE_HZ, rng)
        self._photograph()
        self._put_imu(self._camera_imu.read_at_rest(self._base.rotation[2], SUBSTEPS))

    def _advance_sensors(self) -> None:
        self._photograph()
        self._put_imu(self._camera_imu.read(self._track))

    def _photograph(self) -> None:
        assert self._camera is not None
        pose = base_to_world(self._base) @ self._camera_to_base @ self._tilt
        self._frame: RgbdReading = self._camera.step(self.time_s, pose, self._body_shapes.shapes)

    def _put_imu(self, samples: np.ndarray) -> None:
        self._imu_samples = np.clip(samples, -IMU_BOUND, IMU_BOUND).astype(np.float32)

    def _sense(self) -> dict[str, np.ndarray]:
        return {
            "proprio": self._proprio(),
            "imu": self._imu_samples.copy(),
            "rgb": self._frame.rgb.copy(),
            "depth": np.clip(self._frame.depth_m, 0.0, FAR_M),
        }

    def _info(self, terms: dict[str, float], termination: str) -> dict[str, Any]:
        info = super()._info(terms, termination)
        info["camera"] = {
            "frame": self._frame.frame_index,
            "captured_at_s": self._frame.captured_at_s,
            "time_s": self.time_s,
        }
        return info

    def onlooker_view(self) -> np.ndarray:
        """Third-person picture with the scene's materials and light, uint8 (480, 640, 3); needs no render_mode."""
        if self._follower is None:
            self._follower = FollowCamera(self.scene)
        return self._follower.look(self.state.after.position, self._body_shapes.shapes())

    def close(self) -> None:
        """Release the physics and the camera; safe to call twice."""
        self._camera = None
        super().close()


def _rotation_about_x(angle: float) -> np.ndarray:
    """(4, 4) rotation about the camera's x axis."""
    cos, sin = np.cos(angle), np.sin(angle)
    transform = np.eye(4)
    transform[1:3, 1:3] = [[cos, -sin], [sin, cos]]
    return transform
