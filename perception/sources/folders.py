"""Frames from files: a pair, two folders, a labelled set, a TUM-style folder with time stamps, or colour alone.

Beside a colour image `name.png` an optional `name.json` may hold intrinsics, gravity and depth_scale; it overrides
the options. A TUM-style folder has `rgb.txt`, `depth.txt` and perhaps `accelerometer.txt` and `gyro.txt`: lines
of a time in seconds and a file or three numbers. `camera.json` there holds intrinsics
(`perception.lens.calibration_files`) and depth_scale.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from perception.data.frame_files import d435i_intrinsics
from perception.data.stair_dataset import DEPTHS, MILLIMETRE, read_colour, read_side_car
from perception.estimator import check_gravity
from perception.lens.calibration_files import lens_from_values
from perception.lens.lenses import Lens
from perception.sources.depth_files import COLOUR_SUFFIXES, DEPTH_SUFFIXES, is_grey_16_bit, read_depth_file
from perception.sources.hints import ASSUMED_D435I, SAME_FILE, SWAPPED
from perception.sources.source import ImuSamples, RawFrame, SourceError, no_samples
from stair_env.intrinsics import D435I_COLOR_MODES

CAMERA_FILE = "camera.json"
TUM_LISTS = ("rgb.txt", "depth.txt", "accelerometer.txt", "gyro.txt")
TUM_UNIT_M = 1.0 / 5000.0  # the format's unit of depth
MAX_APART_S = 0.02  # between colour and depth of one frame, as the format's own tools take it
DEPTH_FOLDERS = (DEPTHS, "depth", "depths")
COLOUR_FOLDERS = ("images", "rgb", "color", "colour")
FRAME_S = 1.0 / 30.0  # between files without time stamps
LENS_KEYS = ("fx", "K", "k", "camera_matrix")


@dataclass(frozen=True)
class FileOptions:
    """How files are read where no side-car says otherwise.

    Args:
        depth_scale_m: metres a unit of depth; None: the format's (millimetres; TUM's 0.2 mm).
        grey_level_m: metres a level of 8-bit depth; None: the public set's, with a hint.
    """

    depth_scale_m: float | None = None
    grey_level_m: float | None = None


class FilePairs:
    """Colour files and the depth files that belong to them.

    Args:
        pairs: colour and depth, None where a frame has only colour.
        options: how they are read.
        name: what the whole is called.
    """

    def __init__(
        self, pairs: Sequence[tuple[Path, Path | None]], options: FileOptions = FileOptions(), name: str = ""
    ) -> None:
        self._pairs, self._options = tuple(pairs), options
        self._name = name or str(pairs[0][0])

    @property
    def name(self) -> str:
        """The folder or the file."""
        return self._name

    @property
    def files(self) -> tuple[tuple[Path, Path | None], ...]:
        """The pairs."""
        return self._pairs

    def __len__(self) -> int:
        """How many frames."""
        return len(self._pairs)

    def __iter__(self) -> Iterator[RawFrame]:
        """Read one pair after the other; file k is taken to be k / 30 s after the first."""
        for index, (colour, depth) in enumerate(self._pairs):
            side_car = colour.with_suffix(".json")
            meta = read_side_car(side_car) if side_car.is_file() else {}
            yield read_pair(colour, depth, self._options, meta, str(side_car), index * FRAME_S)

    def close(self) -> None:
        """Nothing is held open."""


def read_pair(
    colour: Path, depth: Path | None, options: FileOptions, meta: dict[str, Any], where: str, time_s: float
) -> RawFrame:
    """One frame of files.

    Args:
        colour, depth: the files; depth None for colour alone.
        options: how they are read.
        meta: side-car values, which override.
        where: the side-car, for errors.
        time_s: of the capture.

    Raises:
        SourceError: the side-car holds what does not fit.
        DatasetError: a file cannot be read (a ValueError).
    """
    rgb, hints, depth_m = read_colour(colour), [], None
    if depth is not None and colour.resolve() == depth.resolve():
        hints.append(SAME_FILE)
    elif depth is not None:
        scale = meta.get("depth_scale", options.depth_scale_m)
        read = read_depth_file(depth, MILLIMETRE if scale is None else _unit(scale, where), options.grey_level_m)
        depth_m = read.depth_m
        swapped = depth_m is None and is_grey_16_bit(colour)
        hints.extend([SWAPPED] if swapped else read.hints)
        if depth_m is not None and _same_picture(rgb, depth):
            hints, depth_m = [SAME_FILE], None
    height, width = rgb.shape[:2]
    if any(key in meta for key in LENS_KEYS):
        lens = lens_from_values(meta, width, height, where)
    else:
        lens = Lens(d435i_intrinsics(width, height))
        if not _is_d435i_size(width, height):
            hints.append(ASSUMED_D435I)
    gravity = None
    if "gravity" in meta:
        try:
            gravity = check_gravity(meta["gravity"])
        except ValueError as error:
            raise SourceError(f"{where}: {error}") from None
    files = (str(colour),) if depth is None else (str(colour), str(depth))
    return RawFrame(colour.stem, time_s, rgb, depth_m, lens, gravity=gravity, hints=tuple(hints), files=files)


def _is_d435i_size(width: int, height: int) -> bool:
    shapes = [(mode.width, mode.height) for mode in D435I_COLOR_MODES.values()]
    return width == height or any(width * h == height * w for w, h in shapes)


def _unit(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value < 1.0:
        raise SourceError(f"{where}: depth_scale={value!r} must be metres a unit of depth, between 0 and 1")
    return float(value)


def _same_picture(rgb: np.ndarray, depth: Path) -> bool:
    """Whether the depth file shows the colour image, in grey or another container."""
    if depth.suffix.lower() not in COLOUR_SUFFIXES:
        return False
    picture = read_colour(depth)
    if picture.shape != rgb.shape:
        return False
    grey = rgb.mean(axis=2)
    return float(np.abs(picture.mean(axis=2) - grey).mean()) < 2.0 and float(grey.std()) > 4.0


# ---------------------------------------------------------------------- which files belong together


def colour_files(folder: Path) -> list[Path]:
    """Images of a folder by name; hidden files are none.

    Raises:
        SourceError: it holds none.
    """
    found = sorted(p for p in folder.iterdir() if p.suffix.lower() in COLOUR_SUFFIXES and not p.name.startswith("."))
    if not found:
        raise SourceError(f"{folder}: holds no image ({', '.join(COLOUR_SUFFIXES)})")
    return found


def paired_folders(colour: Path, depth: Path) -> list[tuple[Path, Path | None]]:
    """Colour and depth files of the same names, endings aside.

    Raises:
        SourceError: a folder holds no image, or an image lacks its twin.
    """
    twins = {p.stem: p for p in depth.iterdir() if p.suffix.lower() in DEPTH_SUFFIXES and not p.name.startswith(".")}
    found: list[tuple[Path, Path | None]] = []
    for path in colour_files(colour):
        if path.stem not in twins:
            raise SourceError(f"{depth}: lacks a depth image named {path.stem}")
        found.append((path, twins[path.stem]))
    return found


def folder_pairs(folder: Path) -> list[tuple[Path, Path | None]]:
    """Frames of one folder: of its colour and depth folders, or of the images in it, which are colour alone.

    Raises:
        SourceError: there is nothing that can be read.
    """
    colours = [folder / name for name in COLOUR_FOLDERS if (folder / name).is_dir()]
    depths = [folder / name for name in DEPTH_FOLDERS if (folder / name).is_dir()]
    if colours and depths:
        return paired_folders(colours[0], depths[0])
    return [(path, None) for path in colour_files(colours[0] if colours else folder)]


# ---------------------------------------------------------------------- TUM-style folders


def is_tum_folder(folder: Path) -> bool:
    """Whether a folder lists its files with time stamps."""
    return (folder / TUM_LISTS[0]).is_file()


class TumFolder:
    """A folder of files with time stamps.

    Args:
        folder: that holds `rgb.txt`.
        options: how depth is read.

    Raises:
        SourceError: a list or `camera.json` cannot be read.
    """

    def __init__(self, folder: Path, options: FileOptions = FileOptions()) -> None:
        self._folder = folder
        lists = [read_stamped(folder / name) if (folder / name).is_file() else [] for name in TUM_LISTS]
        self._colour = [(time, folder / str(words[0])) for time, words in lists[0]]
        self._depth = [(time, folder / str(words[0])) for time, words in lists[1]]
        self._imu = [_numbers(rows, folder / name) for rows, name in zip(lists[2:], TUM_LISTS[2:])]
        if not self._colour:
            raise SourceError(f"{folder / TUM_LISTS[0]}: lists no file")
        meta = read_side_car(folder / CAMERA_FILE)
        scale = meta.get("depth_scale", options.depth_scale_m)
        self._options = FileOptions(TUM_UNIT_M if scale is None else scale, options.grey_level_m)
        self._meta = {key: value for key, value in meta.items() if key not in ("depth_scale", "depth_to_colour")}

    @property
    def name(self) -> str:
        """The folder."""
        return str(self._folder)

    def __len__(self) -> int:
        """How many colour images."""
        return len(self._colour)

    def __iter__(self) -> Iterator[RawFrame]:
        """Colour images in the order of time, each with the depth that is nearest in time, if it is near."""
        times = np.array([time for time, _ in self._depth])
        last_s = -np.inf
        for time_s, colour in self._colour:
            depth = None
            if len(times):
                index = int(np.argmin(np.abs(times - time_s)))
                depth = self._depth[index][1] if abs(times[index] - time_s) <= MAX_APART_S else None
            where = str(self._folder / CAMERA_FILE)
            raw = read_pair(colour, depth, self._options, self._meta, where, time_s)
            imu = [rows[(rows[:, 0] > last_s) & (rows[:, 0] <= time_s)] for rows in self._imu]
            last_s = time_s
            yield dataclasses.replace(raw, imu=ImuSamples(*imu))

    def close(self) -> None:
        """Nothing is held open."""


def read_stamped(path: Path) -> list[tuple[float, list[str]]]:
    """Lines of a list: time in seconds, and the words behind it.

    Raises:
        SourceError: a line has no time, or nothing behind it; times run backwards.
    """
    rows: list[tuple[float, list[str]]] = []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise SourceError(f"{path}: not text: {error}") from None
    for number, line in enumerate(lines, start=1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            time_s = float(words[0])
        except ValueError:
            time_s = np.nan
        if not np.isfinite(time_s) or len(words) < 2:
            raise SourceError(f"{path}:{number}: must be a time in seconds and what belongs to it, is {line!r}")
        if rows and time_s < rows[-1][0]:
            raise SourceError(f"{path}:{number}: time runs backwards")
        rows.append((time_s, words[1:]))
    return rows


def _numbers(rows: list[tuple[float, list[str]]], path: Path) -> np.ndarray:
    """(k, 4) time and three numbers."""
    if not rows:
        return no_samples()
    try:
        found = np.array([[time, *map(float, words[:3])] for time, words in rows])
    except ValueError:
        found = np.zeros((0, 0))
    if found.ndim != 2 or found.shape[1] != 4:
        raise SourceError(f"{path}: must hold a time and three numbers a line")
    return found
