"""PyBullet's own renderers: TinyRenderer in software, and OpenGL through the EGL plugin."""

from __future__ import annotations

import ctypes
import importlib.util
import logging
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np

from stair_env.common.console import stdout_to_stderr
from stair_env.intrinsics import Intrinsics
from stair_env.scene.appearance import AppearanceSpec
from stair_env.scene.shapes import Shape
from stair_env.sensors.camera.renderers.base import Frame, SceneLike, check_pose

logger = logging.getLogger(__name__)

# Numbers of PyBullet's constants, so that this module can be imported without it.
_TINY_RENDERER, _HARDWARE_OPENGL = 1 << 16, 1 << 17
_loaded: weakref.WeakKeyDictionary[Any, int] = weakref.WeakKeyDictionary()  # plugin number of each client
_EGL_PLATFORM_PACKAGES = "libegl1 and libgl1-mesa-dri"
# A narrower range than the ray caster's: a 24-bit depth buffer resolves z^2 / (near 2^24), 0.03 mm at 5 m.
BULLET_NEAR_M = 0.05
BULLET_FAR_M = 60.0
TYPICAL_LAMP_DISTANCE_M = 2.0  # from a ceiling to the stairs
DISPLAY_SHARE = 0.6  # of white that each of full ambient and full direct light gives
DISPLAY_GAMMA = 0.45  # Bullet adds light up in display values
SPECULAR_SHARE = 0.1  # most building materials are matt
FLOAT32_STEP = 2.0**-22  # TinyRenderer's buffer ends a rounding error short of 1
# Measured against analytic planes: TinyRenderer samples a pixel at its lower left corner, not in its centre.
TINY_SAMPLE_SHIFT_PX = 0.5
GL_FROM_OPTICAL = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's camera looks along -z with y up


def view_matrix(camera_to_world: np.ndarray) -> tuple[float, ...]:
    """OpenGL view matrix, 16 numbers column by column, of an optical camera pose (4, 4); roll included."""
    rotation, position = camera_to_world[:3, :3], camera_to_world[:3, 3]
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = rotation.T
    world_to_camera[:3, 3] = -rotation.T @ position
    return tuple((GL_FROM_OPTICAL @ world_to_camera).T.ravel().tolist())


def projection_matrix(
    intrinsics: Intrinsics, near_m: float, far_m: float, sample_shift_px: float = 0.0
) -> tuple[float, ...]:
    """OpenGL projection matrix of a pinhole whose principal point may be anywhere.

    Args:
        intrinsics: of the image.
        near_m, far_m: clipping planes, metres.
        sample_shift_px: how far left of and below its centre the renderer samples a pixel.

    Returns:
        16 numbers, column by column.
    """
    width, height = intrinsics.width, intrinsics.height
    cx, cy = intrinsics.cx - sample_shift_px, intrinsics.cy + sample_shift_px
    matrix = np.zeros((4, 4))
    matrix[0, 0] = 2.0 * intrinsics.fx / width
    matrix[0, 2] = 1.0 - 2.0 * cx / width
    matrix[1, 1] = 2.0 * intrinsics.fy / height
    matrix[1, 2] = 2.0 * cy / height - 1.0
    matrix[2, 2] = -(far_m + near_m) / (far_m - near_m)
    matrix[2, 3] = -2.0 * far_m * near_m / (far_m - near_m)
    matrix[3, 2] = -1.0
    return tuple(matrix.T.ravel().tolist())


def linear_depth(buffer: np.ndarray, near_m: float, far_m: float) -> np.ndarray:
    """Depth along the optical axis from an OpenGL depth buffer in 0..1; 0 where the buffer is at its end.

    Args:
        buffer: any shape.
        near_m, far_m: as in the projection matrix, metres.

    Returns:
        float32, same shape, metres.
    """
    values = np.asarray(buffer, dtype=np.float64)
    depth = far_m * near_m / (far_m - (far_m - near_m) * values)
    return np.where(values < 1.0 - FLOAT32_STEP, depth, 0.0).astype(np.float32)


def bullet_light(appearance: AppearanceSpec, shadows: bool) -> dict[str, Any]:
    """The lighting arguments of getCameraImage that come closest to an appearance; Bullet knows no textures of ours."""
    lamp = appearance.lamp_position
    at_scene = appearance.light_intensity if lamp is None else appearance.light_intensity / TYPICAL_LAMP_DISTANCE_M**2
    ambient, direct = (
        DISPLAY_SHARE * min(appearance.exposure * light, 1.0) ** DISPLAY_GAMMA
        for light in (appearance.ambient_level, at_scene)
    )
    return {
        "lightDirection": list(appearance.light_direction if lamp is None else lamp),
        "lightColor": list(appearance.light_colour),
        "lightAmbientCoeff": ambient,
        "lightDiffuseCoeff": direct,
        "lightSpecularCoeff": SPECULAR_SHARE * min(appearance.specular_strength, 1.0) * direct,
        "shadow": int(shadows and appearance.shadows),
    }


class BulletRenderer:
    """Draws the bodies of a PyBullet client as they are; moving shapes must be bodies there.

    Args:
        scene: its shapes give the segmentation its numbers; they must be bodies of the client.
        client: the PyBullet client; it stays the caller's.
        hardware: OpenGL through the EGL plugin instead of TinyRenderer.
        bodies: body ids of the scene's shapes, in their order; None for 0, 1, 2, ...
        appearance: where the light comes from; None for the scene's own (`scene.spec.appearance`), or the default.
        shadows: whether the light casts shadows.

    Raises:
        ValueError: bodies and shapes differ in number.
        RuntimeError: EGL cannot be loaded (the message names what to install), or was not before the bodies were made,
            or has taken TinyRenderer's place.
    """

    def __init__(
        self,
        scene: SceneLike,
        client: Any,
        *,
        hardware: bool = False,
        bodies: Sequence[int] | None = None,
        appearance: AppearanceSpec | None = None,
        shadows: bool = True,
    ) -> None:
        bodies = range(len(scene.shapes)) if bodies is None else bodies
        if len(bodies) != len(scene.shapes):
            raise ValueError(f"bodies has {len(bodies)} ids, the scene has {len(scene.shapes)} shapes")
        self._client = client
        self._index = {body: index for index, body in enumerate(bodies)}
        if appearance is None:
            appearance = getattr(getattr(scene, "spec", None), "appearance", None) or AppearanceSpec()
        self._light = bullet_light(appearance, shadows)
        if hardware:
            _require_egl(client)
        elif client in _loaded:
            raise RuntimeError("this client draws everything with EGL since load_egl(client): renderer 'tiny' is gone")
        self._sample_shift_px = 0.0 if hardware else TINY_SAMPLE_SHIFT_PX
        self._renderer = _HARDWARE_OPENGL if hardware else _TINY_RENDERER

    def render(self, intrinsics: Intrinsics, camera_to_world: np.ndarray, *, moving: Sequence[Shape] = ()) -> Frame:
        """Draw a frame; see `Renderer.render`.

        The segmentation holds len(scene.shapes) for every body that is none of the scene's shapes. moving is not read.

        Raises:
            ValueError: the pose is not a rigid transform.
        """
        pose = check_pose(camera_to_world)
        width, height = intrinsics.width, intrinsics.height
        _, _, rgba, buffer, mask = self._client.getCameraImage(
            width,
            height,
            viewMatrix=view_matrix(pose),
            projectionMatrix=projection_matrix(intrinsics, BULLET_NEAR_M, BULLET_FAR_M, self._sample_shift_px),
            renderer=self._renderer,
            **self._light,
        )
        # Without NumPy support in PyBullet's build these are flat tuples.
        rgba = np.asarray(rgba, dtype=np.uint8).reshape(height, width, 4)
        depth = linear_depth(np.asarray(buffer, dtype=np.float32).reshape(height, width), BULLET_NEAR_M, BULLET_FAR_M)
        segmentation = self._numbered(np.asarray(mask, dtype=np.int32).reshape(height, width))
        return Frame(np.ascontiguousarray(rgba[..., :3]), depth, np.where(depth > 0.0, segmentation, -1))

    def _numbered(self, mask: np.ndarray) -> np.ndarray:
        """Shape indices (H, W) int32 from body ids."""
        present, inverse = np.unique(mask, return_inverse=True)
        other = len(self._index)
        numbers = [-1 if body < 0 else self._index.get(body, other) for body in present.tolist()]
        return np.array(numbers, dtype=np.int32)[inverse].reshape(mask.shape)

    def close(self) -> None:
        """Nothing to release: the plugin and the bodies are the client's."""


def load_egl(client: Any) -> int:
    """Load PyBullet's EGL plugin into a client, once; OpenGL draws only bodies that are made afterwards.

    Returns:
        The plugin's number.

    Raises:
        RuntimeError: it cannot be loaded; the message names what to install.
    """
    if client in _loaded:
        return _loaded[client]
    spec = importlib.util.find_spec("eglRenderer")
    if spec is None or spec.origin is None:
        raise RuntimeError("renderer 'egl' needs PyBullet's eglRenderer plugin, which this build of PyBullet lacks")
    problem = _egl_problem()
    # The plugin ends the process when it finds no display, so it is loaded only where EGL was seen to work.
    with stdout_to_stderr():
        plugin = client.loadPlugin(spec.origin, "_eglRendererPlugin") if problem is None else -1
    if plugin < 0:
        raise RuntimeError(
            f"renderer 'egl' cannot start OpenGL ({problem or 'the plugin did not load'}): "
            f"install the Debian packages {_EGL_PLATFORM_PACKAGES}, or use renderer 'raycast' or 'tiny'"
        )
    logger.debug("loaded %s", spec.origin)
    _loaded[client] = int(plugin)
    return _loaded[client]


def _require_egl(client: Any) -> None:
    if client not in _loaded and client.getNumBodies() > 0:
        raise RuntimeError("renderer 'egl' draws only bodies made after its plugin: call load_egl(client) before them")
    load_egl(client)


def _egl_problem() -> str | None:
    """Why EGL has no display to draw on, or None when it has."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError as error:
        return str(error)
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    egl.eglGetProcAddress.argtypes = [ctypes.c_char_p]
    address = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    if not address:
        return "libEGL cannot list devices"
    query = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.POINTER(ctypes.c_int))(address)
    count = ctypes.c_int(0)
    if not query(0, None, ctypes.byref(count)) or count.value < 1:
        return "libEGL finds no device"
    return None
