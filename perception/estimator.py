"""RGB-D frame in, staircase out: the numpy border of perception.

`StairEstimator` runs the network, clusters its answer into lines and measures the staircase. Input is checked here,
so that nothing behind this module meets a wrong shape, a gravity without direction, or NaN.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Literal, Protocol

import numpy as np

from perception.geometry.lines import SCORE_THRESHOLD, as_stair_lines, find_lines, to_image_pixels
from perception.geometry.paper import measure_stairs_as_the_paper
from perception.geometry.planes import GRAVITY_STD_RAD, OMEGA_M, Geometry, attitude_angles, measure_stairs
from perception.geometry.results import StairEstimate
from stair_env.common.constants import BACKENDS, GEOMETRY_METHODS, NETWORK_WIDTHS
from stair_env.common.pickling import PicklesByArguments
from stair_env.common.validation import check_choice
from stair_env.intrinsics import Intrinsics

LOGGER = logging.getLogger(__name__)

WEAK_SCORE_THRESHOLD = 0.3  # of cells that count if depth shows an edge there: coverage 85 % -> 90 % going up
MIN_GRAVITY = 1e-3  # m/s^2: less is no direction
MAX_INTRINSICS_MISMATCH_PX = 0.5

Method = Literal["planes", "paper"]


class Detector(Protocol):
    """Whatever turns images into the network's two tensors."""

    def detect(self, rgb: Sequence[np.ndarray], depth_m: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Run on a batch.

        Args:
            rgb: B images uint8 (H, W, 3).
            depth_m: B images float32 (H, W), metres, 0 = no reading, finite.

        Returns:
            cls (B, 32, 16) and loc (B, 32, 16, 8).
        """


class StairEstimator(PicklesByArguments):
    """Measures stairs in RGB-D frames.

    Args:
        width: width factor of StairNetV2: 1.0, 0.5 or 0.25.
        backend: one of `perception.inference.backends.BACKENDS`: "onnx" (default), "openvino" (faster;
            an extra) or "torch".
        detector: used instead of the network when given (an ideal detector in tests, a model of your own).
        method: "planes" (default: fits treads and risers) or "paper" (equations 7 to 9).
        threshold: least class score of a cell; None: the paper's for its method, and less for "planes", where depth
            has to confirm what is less than certain.
        omega_m: smallest width and height that counts as a step; the paper's threshold.
        gravity_std_rad: how far the given gravity direction is trusted.
        refine_gravity: see `perception.geometry.planes.measure_stairs`; wrappers and deployment, which know their
            attitude, make estimators without.

    Raises:
        ValueError: an argument is none of its choices.
    """

    def __init__(
        self,
        width: float = 0.25,
        backend: str = "onnx",
        *,
        detector: Detector | None = None,
        method: Method = "planes",
        threshold: float | None = None,
        omega_m: float = OMEGA_M,
        gravity_std_rad: float = GRAVITY_STD_RAD,
        refine_gravity: bool = True,
    ) -> None:
        check_choice("method", method, GEOMETRY_METHODS)
        check_choice("backend", backend, BACKENDS)
        if width not in NETWORK_WIDTHS:
            raise ValueError(f"width={width!r} must be one of {', '.join(map(str, NETWORK_WIDTHS))}")
        self._detector = detector if detector is not None else _load_network(width, backend)
        self._method = method
        usual = SCORE_THRESHOLD if method == "paper" else WEAK_SCORE_THRESHOLD
        self._threshold = usual if threshold is None else threshold
        self._sure_threshold = SCORE_THRESHOLD if threshold is None else threshold
        self._omega_m = omega_m
        self._gravity_std_rad, self._refine_gravity = gravity_std_rad, refine_gravity

    @property
    def detector(self) -> Detector:
        """What turns images into the network's tensors; other estimators may share it."""
        return self._detector

    def detect(self, rgb: np.ndarray, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The network's answer.

        Args:
            rgb: uint8 (H, W, 3).
            depth_m: float (H, W), metres, 0 = no reading; NaN and infinity count as no reading.

        Returns:
            cls (32, 16) scores in 0..1 and loc (32, 16, 8) coordinates within the cell in 0..1.

        Raises:
            ValueError: wrong shape or dtype.
        """
        check_images(rgb, depth_m)
        cls, loc = self._detector.detect([rgb], [_clean_depth(depth_m)])
        return cls[0], loc[0]

    def estimate(
        self, rgb: np.ndarray, depth_m: np.ndarray, intrinsics: Intrinsics, gravity: np.ndarray | None
    ) -> StairEstimate:
        """Measure the staircase in one frame.

        Args:
            rgb: uint8 (H, W, 3).
            depth_m: float (H, W), aligned to rgb, metres, 0 = no reading; NaN and infinity count as no reading.
            intrinsics: of both images.
            gravity: (3,) accelerometer reading at rest in the camera frame (x right, y down, z forward), m/s^2;
                (0, -9.8, 0) when level. None when unknown: treads and risers tell it then.

        Returns:
            StairEstimate; not valid, with a reason, when there is no staircase to measure.

        Raises:
            ValueError: wrong shape, dtype, gravity or intrinsics; the message says which.
        """
        return self.estimate_batch([rgb], [depth_m], [intrinsics], [gravity])[0]

    def estimate_batch(
        self,
        rgb: Sequence[np.ndarray],
        depth_m: Sequence[np.ndarray],
        intrinsics: Sequence[Intrinsics],
        gravity: Sequence[np.ndarray | None],
    ) -> list[StairEstimate]:
        """`estimate` for B frames in one run of the network; sequences of equal length."""
        counts = {len(rgb), len(depth_m), len(intrinsics), len(gravity)}
        if len(counts) != 1:
            raise ValueError(
                f"rgb, depth_m, intrinsics and gravity have {len(rgb)}, {len(depth_m)}, {len(intrinsics)} and "
                f"{len(gravity)} entries, must be equally many"
            )
        if len(rgb) == 0:
            return []
        for image, depth, model, reading in zip(rgb, depth_m, intrinsics, gravity):
            check_images(image, depth)
            check_intrinsics(model, image)
            self._check_gravity(reading)
        clean = [_clean_depth(depth) for depth in depth_m]
        cls, loc = self._detector.detect(rgb, clean)
        return [
            self.interpret(cls[index], loc[index], clean[index], intrinsics[index], gravity[index])
            for index in range(len(rgb))
        ]

    def _check_gravity(self, gravity: np.ndarray | None) -> np.ndarray | None:
        if gravity is None and self._method == "paper":
            raise ValueError("gravity=None, but method='paper' takes the attitude from it (equation 8)")
        return None if gravity is None else check_gravity(gravity)

    def interpret(
        self, cls: np.ndarray, loc: np.ndarray, depth_m: np.ndarray, intrinsics: Intrinsics, gravity: np.ndarray | None
    ) -> StairEstimate:
        """Everything behind the network: lines, clusters, geometry.

        Args:
            cls, loc: the network's answer for this frame.
            depth_m: float (H, W), metres, 0 = no reading.
            intrinsics: of the depth image.
            gravity: (3,) as in `estimate`.
        """
        gravity = self._check_gravity(gravity)
        lines = to_image_pixels(find_lines(cls, loc, self._threshold), intrinsics.width, intrinsics.height)
        if self._method == "paper" and gravity is not None:
            geometry = measure_stairs_as_the_paper(lines, depth_m, intrinsics, gravity, omega_m=self._omega_m)
        else:
            geometry = measure_stairs(
                lines,
                depth_m,
                intrinsics,
                gravity,
                omega_m=self._omega_m,
                gravity_std_rad=self._gravity_std_rad,
                refine_gravity=self._refine_gravity,
            )
        return _as_estimate(geometry, lines, gravity, self._sure_threshold)


def _as_estimate(
    geometry: Geometry, lines: np.ndarray, gravity: np.ndarray | None, sure_threshold: float
) -> StairEstimate:
    upright = gravity if gravity is not None and geometry.gravity_source == "imu" else geometry.up
    pitch, roll = attitude_angles(upright) if upright is not None else (0.0, 0.0)
    order = np.argsort(-(lines[:, 1] + lines[:, 3])) if len(lines) else np.empty(0, dtype=int)
    # A line of weak cells is one only if geometry found it to be an edge.
    sure = (lines[:, 6] >= sure_threshold) | (np.array(geometry.kinds, dtype=str) != "unknown")
    order = order[sure[order]]
    found = as_stair_lines(lines[order], tuple(geometry.kinds[index] for index in order))
    valid = geometry.direction != 0 and any(nosing.riser_m is not None for nosing in geometry.nosings)
    return StairEstimate(
        valid=valid,
        direction=geometry.direction if valid else 0,
        lines=found,
        steps=geometry.steps,
        nosings=geometry.nosings,
        pitch_rad=pitch,
        roll_rad=roll,
        yaw_rad=geometry.yaw_rad,
        yaw_std_rad=geometry.yaw_std_rad,
        next_edge_m=geometry.nosings[0].distance_m if valid else 0.0,
        reason="" if valid else geometry.reason or "no complete riser in view",
        gravity_source=geometry.gravity_source,
        gravity_correction_rad=geometry.gravity_correction_rad,
    )


def check_images(rgb: np.ndarray, depth_m: np.ndarray) -> None:
    """Raise ValueError unless rgb is uint8 (H, W, 3) and depth a float (H, W) of the same size."""
    if not isinstance(rgb, np.ndarray) or rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.size == 0:
        raise ValueError(f"rgb has shape {np.shape(rgb)}, must be an array (H, W, 3)")
    if rgb.dtype != np.uint8:
        raise ValueError(f"rgb has dtype {rgb.dtype}, must be uint8")
    if not isinstance(depth_m, np.ndarray) or depth_m.shape != rgb.shape[:2]:
        raise ValueError(f"depth has shape {np.shape(depth_m)}, must be {rgb.shape[:2]} like rgb")
    if not np.issubdtype(depth_m.dtype, np.floating):
        raise ValueError(f"depth has dtype {depth_m.dtype}, must be float metres (divide 16-bit millimetres by 1000)")


def check_intrinsics(intrinsics: Intrinsics, rgb: np.ndarray) -> None:
    """Raise ValueError unless the intrinsics are those of an image of rgb's size."""
    if not isinstance(intrinsics, Intrinsics):
        raise ValueError(f"intrinsics={intrinsics!r} must be stair_env.intrinsics.Intrinsics")
    if (intrinsics.height, intrinsics.width) != rgb.shape[:2]:
        raise ValueError(
            f"intrinsics are those of a {intrinsics.width}x{intrinsics.height} image, rgb is "
            f"{rgb.shape[1]}x{rgb.shape[0]}; use Intrinsics.scaled"
        )


def check_gravity(gravity: np.ndarray) -> np.ndarray:
    """(3,) float64; raise ValueError unless it is three finite numbers with a direction."""
    try:
        vector = np.asarray(gravity, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"gravity={gravity!r} must be three finite numbers") from None
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"gravity={gravity!r} must be three finite numbers")
    if np.linalg.norm(vector) < MIN_GRAVITY:
        raise ValueError(f"gravity={gravity!r} has no length, so no direction")
    return vector


def _clean_depth(depth_m: np.ndarray) -> np.ndarray:
    """float32 with NaN, infinity and negative readings as 0 = no reading."""
    depth = np.asarray(depth_m, dtype=np.float32)
    if depth.min(initial=0.0) >= 0.0 and depth.max(initial=0.0) < np.inf:  # NaN compares false
        return depth
    return np.where(np.isfinite(depth) & (depth > 0.0), depth, np.float32(0.0))


def _load_network(width: float, backend: str) -> Detector:
    from perception.inference.detector import NetworkDetector

    return NetworkDetector(width, backend)
