"""From what a source has to what the estimator takes: rectified, depth aligned to colour, gravity, hints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from perception.estimator import check_gravity
from perception.lens.calibration_files import read_extrinsics, read_lens
from perception.lens.lenses import Lens, Rectifier
from perception.sources.hints import ASSUMED_D435I, frame_hints
from perception.sources.imu_gravity import ImuGravity
from perception.sources.source import ImuSamples, MissingImuError, RawFrame, Source, SourceError, UnalignedDepthError
from stair_env.common.validation import check_choice
from stair_env.intrinsics import Intrinsics

IMU_USES = ("auto", "required", "off")
FRAMES_WITHOUT_IMU = 30  # a second: after so many without a sample a source has no IMU


@dataclass(frozen=True)
class Preparation:
    """What to do with a source's frames.

    Args:
        intrinsics: file that takes the place of what the source says of its colour camera.
        depth_intrinsics: the same of the depth camera; depth is then not aligned to colour.
        extrinsics: file with the transform from the depth to the colour camera.
        gravity: (3,) accelerometer at rest, camera axes, instead of the IMU's; None takes that.
        imu: "auto", "required" (a source without one is refused) or "off".

    Raises:
        SpecError: imu is none of its choices (a ValueError).
        ValueError: gravity has no direction.
    """

    intrinsics: Path | None = None
    depth_intrinsics: Path | None = None
    extrinsics: Path | None = None
    gravity: tuple[float, float, float] | None = None
    imu: str = "auto"

    def __post_init__(self) -> None:
        check_choice("imu", self.imu, IMU_USES)
        if self.gravity is not None:
            check_gravity(np.array(self.gravity))


@dataclass(frozen=True)
class SourceFrame:
    """A frame as `StairEstimator.estimate` takes it.

    Attributes:
        name, time_s: of the source's frame.
        rgb: uint8 (H, W, 3), rectified.
        depth_m: float32 (H, W) metres, aligned to rgb, 0 = no reading; None when there is only colour.
        intrinsics: of both.
        gravity: (3,) accelerometer at rest, camera axes; None when nobody says.
        gravity_source: "given", "imu" or "none".
        hints: what looks wrong.
        imu: samples since the last frame.
        files: colour and depth, for a frame that was read from files of its own.
    """

    name: str
    time_s: float
    rgb: np.ndarray
    depth_m: np.ndarray | None
    intrinsics: Intrinsics
    gravity: np.ndarray | None
    gravity_source: str
    hints: tuple[str, ...] = ()
    imu: ImuSamples = field(default_factory=ImuSamples)
    files: tuple[str, ...] = ()


def prepared(source: Source, preparation: Preparation = Preparation()) -> Iterator[SourceFrame]:
    """A source's frames, ready for the estimator.

    Raises:
        SourceError: a frame cannot be used (`UnalignedDepthError`, `MissingImuError`), or the source ends early.
    """
    preparer = Preparer(preparation, source.name)
    for raw in source:
        yield preparer.prepare(raw)


class Preparer:
    """Prepares one source's frames in order.

    Args:
        preparation: what to do.
        name: of the source, for errors.
    """

    def __init__(self, preparation: Preparation = Preparation(), name: str = "source") -> None:
        self._preparation, self._name = preparation, name
        self._imu = ImuGravity()
        self._rectifiers: dict[Lens, Rectifier] = {}
        self._lenses: dict[tuple[Path, tuple[int, int]], Lens] = {}
        self._extrinsics = read_extrinsics(preparation.extrinsics) if preparation.extrinsics else None
        self._silent = 0

    def prepare(self, raw: RawFrame) -> SourceFrame:
        """One frame; call in the order of time.

        Raises:
            SourceError: see `prepared`.
        """
        given = self._preparation
        lens = self._lens(given.intrinsics, raw.rgb) or raw.lens
        self._check_size(lens, raw.rgb, "colour")
        gravity, gravity_source = self._gravity(raw)
        depth = self._depth(raw, lens)
        if depth is not None and depth.shape != raw.rgb.shape[:2]:
            raise UnalignedDepthError(
                f"{raw.name}: depth is {depth.shape[1]}x{depth.shape[0]}, "
                f"colour {raw.rgb.shape[1]}x{raw.rgb.shape[0]}; "
                "depth must be aligned to colour, or --depth-intrinsics and --extrinsics must say how the two stand"
            )
        said = (hint for hint in raw.hints if hint != ASSUMED_D435I or given.intrinsics is None)
        hints = (*said, *frame_hints(depth, lens.intrinsics, gravity))
        return SourceFrame(
            raw.name,
            raw.time_s,
            self._rectifier(lens).colour(raw.rgb),
            depth,
            lens.intrinsics,
            gravity,
            gravity_source,
            hints,
            raw.imu,
            raw.files,
        )

    def _depth(self, raw: RawFrame, lens: Lens) -> np.ndarray | None:
        """Depth in the colour camera."""
        if raw.depth_m is None:
            return None
        depth_lens = self._lens(self._preparation.depth_intrinsics, raw.depth_m) or raw.depth_lens
        if depth_lens is None:
            return self._rectifier(lens).depth(raw.depth_m) if raw.depth_m.shape == raw.rgb.shape[:2] else raw.depth_m
        pose = self._extrinsics if self._extrinsics is not None else raw.depth_to_colour
        if pose is None:
            raise UnalignedDepthError(
                f"{self._name}: depth is not aligned to colour, and where the depth camera stands is not known; "
                "record aligned depth, or give --extrinsics FILE (rotation, translation of depth to colour)"
            )
        from perception.lens.alignment import align_depth

        self._check_size(depth_lens, raw.depth_m, "depth")
        flat = self._rectifier(depth_lens).depth(raw.depth_m)
        return align_depth(flat, depth_lens.intrinsics, pose, lens.intrinsics)

    def _gravity(self, raw: RawFrame) -> tuple[np.ndarray | None, str]:
        felt = self._imu.update(raw.imu, raw.time_s) if self._preparation.imu != "off" else None
        self._silent = self._silent + 1 if felt is None else 0
        if self._preparation.imu == "required" and self._silent > FRAMES_WITHOUT_IMU:
            raise MissingImuError(
                f"{self._name}: no IMU samples in {self._silent} frames, and --imu required asks for them"
            )
        if raw.gravity is not None:
            return raw.gravity, "given"
        if self._preparation.gravity is not None:
            return np.array(self._preparation.gravity, np.float64), "given"
        return felt, "none" if felt is None else "imu"

    def _lens(self, path: Path | None, image: np.ndarray) -> Lens | None:
        """Lens of a calibration file for images of this size; read once."""
        if path is None:
            return None
        height, width = image.shape[:2]
        key = (path, (width, height))
        if key not in self._lenses:
            self._lenses[key] = read_lens(path, width, height)
        return self._lenses[key]

    def _rectifier(self, lens: Lens) -> Rectifier:
        if lens not in self._rectifiers:
            if len(self._rectifiers) > 8:  # a folder of frames with a lens each
                self._rectifiers.clear()
            self._rectifiers[lens] = Rectifier(lens)
        return self._rectifiers[lens]

    def _check_size(self, lens: Lens, image: np.ndarray, what: str) -> None:
        model = lens.intrinsics
        if (model.height, model.width) != image.shape[:2]:
            raise SourceError(
                f"{self._name}: intrinsics of the {what} camera are those of {model.width}x{model.height} images, "
                f"these are {image.shape[1]}x{image.shape[0]}"
            )
