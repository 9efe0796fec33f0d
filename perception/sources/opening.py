"""What a user names, opened: a device, a recording, folders, files."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from perception.sources.folders import (
    FileOptions,
    FilePairs,
    TumFolder,
    folder_pairs,
    is_tum_folder,
    paired_folders,
)
from perception.sources.realsense import RealSenseOptions, open_recording
from perception.sources.ros_bags import BagTopics, RosBag
from perception.sources.simulated import SimulatedSource
from perception.sources.source import Source, SourceError

SIMULATED = "simulated"
BAG_SUFFIXES = (".bag", ".db3", ".mcap")
ROS2_NOTE = "metadata.yaml"  # in the folder of a ROS 2 recording
SDK_TOPIC = "/device_0/"  # how the topics of the SDK's own recordings begin
PEEK_BYTES = 1 << 18  # of a .bag's either end


@dataclass(frozen=True)
class SourceOptions:
    """How each kind of source is read.

    Attributes:
        files: folders and files.
        topics: ROS recordings.
        device: RealSense devices, and recordings of the SDK's.
        frames, seed: of the simulated camera.
    """

    files: FileOptions = field(default_factory=FileOptions)
    topics: BagTopics = field(default_factory=BagTopics)
    device: RealSenseOptions = field(default_factory=RealSenseOptions)
    frames: int = 60
    seed: int = 0


def open_source(words: Sequence[str | Path], options: SourceOptions = SourceOptions()) -> Source:
    """Open what one or two words name.

    Args:
        words: "simulated"; a recording (.bag, .db3, .mcap, or the folder of a ROS 2 recording); a folder; a colour
            image; or colour and depth, both files or both folders.
        options: how it is read.

    Raises:
        SourceError: there is nothing of the kind, or it cannot be read; the message says what would do.
    """
    if not 1 <= len(words) <= 2:
        raise SourceError(f"a source is one word or two (RGB DEPTH), got {len(words)}")
    if [str(word) for word in words] == [SIMULATED]:
        return SimulatedSource(options.frames, options.seed)
    paths = [Path(word) for word in words]
    for path in paths:
        if not path.exists():
            raise SourceError(f"{path}: no such file or folder")
    if len(paths) == 2:
        return _open_pair(paths[0], paths[1], options.files)
    path = paths[0]
    if path.suffix.lower() in BAG_SUFFIXES or (path / ROS2_NOTE).is_file():
        if path.is_file() and made_by_sdk(path):
            return open_recording(path, options.device)
        return RosBag(path, options.topics, options.device.need_imu)
    if path.is_file():
        return FilePairs([(path, None)], options.files)
    if is_tum_folder(path):
        return TumFolder(path, options.files)
    return FilePairs(folder_pairs(path), options.files, str(path))


def _open_pair(colour: Path, depth: Path, options: FileOptions) -> Source:
    if colour.is_dir() != depth.is_dir():
        raise SourceError(f"{colour} and {depth} must both be files or both be folders")
    if colour.is_file():
        return FilePairs([(colour, depth)], options)
    return FilePairs(paired_folders(colour, depth), options, str(colour))


def made_by_sdk(path: Path) -> bool:
    """Whether a `.bag` or `.db3` is a recording of librealsense's, which no ROS tool can make sense of."""
    if path.suffix.lower() == ".mcap":
        return False
    if path.suffix.lower() == ".db3":
        try:
            with contextlib.closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
                names = [str(row[0]) for row in database.execute("SELECT name FROM topics")]
        except sqlite3.Error:
            return False  # whoever opens it says what is wrong
        return any(name.startswith(SDK_TOPIC) for name in names)
    with path.open("rb") as file:
        start = file.read(PEEK_BYTES)
        file.seek(max(path.stat().st_size - PEEK_BYTES, 0))
        return SDK_TOPIC.encode() in start or SDK_TOPIC.encode() in file.read()
