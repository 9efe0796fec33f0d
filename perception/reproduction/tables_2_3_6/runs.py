"""The trained networks of tables 2, 3 and 6: what each row is, training what is missing, loading what is there.

Every row and seed has a folder `<row>_s<seed>` with `settings.json`, the trainer's checkpoints, and at the end
`weights.safetensors`. A run killed at any moment goes on from its last checkpoint.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import nn

from perception.data.augmentation import AugmentationConfig
from perception.learning.frames import Encoder, FrameModule, as_arrays
from perception.learning.network_training import DetectorTraining, StairNetTraining, train
from perception.learning.presets import PRESETS, TrainingPreset
from perception.reproduction.baselines.baseline_training import (
    MonocularTraining,
    RoiTraining,
    roi_arrays,
    stairnet_arrays,
)
from perception.reproduction.baselines.other_fusions import ConcatenatingStairNet, FourChannelStairNet
from stair_env.common.field_kinds import naming_fields
from stair_env.common.files import atomic_path, read_json_object

VALIDATION_FRAMES = 16  # after each epoch: enough for the sign of equations 5 and 6, and cheap beside the epoch
WEIGHTS_FILE = "weights.safetensors"
SETTINGS_FILE = "settings.json"

# A short schedule for all learned rows: all epochs but the last two at half size, small batches, so that 20,000 frames
# make 5000 steps and a row costs 20 to 25 minutes of one CPU core. No modality is taken away: the monocular
# rows would have nothing to fall back on. All else is the preset `fast`.
SUITE_PRESET = dataclasses.replace(
    PRESETS["fast"],
    epochs=20,
    frames_per_epoch=1000,
    batch_size=4,
    small_batch_size=4,
    learning_rate=2e-3,
    small_share=18 / 20,
    # The paper's comparison is on the sensor that drew the set: no row is taught to do without either modality.
    augmentation=AugmentationConfig(
        matched_depth=0.0, corrupt_depth=0.0, drop_colour=0.0, drop_depth=0.0, other_depth=0.0, meaningless_depth=0.0
    ),
)


class RunError(ValueError):
    """A folder of runs does not fit what is asked for; the message names folder and difference."""


@dataclass(frozen=True)
class LearnedRow:
    """A network of the tables.

    Attributes:
        make: training module from width and preset.
        encode: its input and targets from a frame.
        half_size: whether all its epochs are at half size, for a network that is used at half size too.
    """

    make: Callable[[float, TrainingPreset], DetectorTraining]
    encode: Encoder = as_arrays
    half_size: bool = False

    def preset(self, common: TrainingPreset) -> TrainingPreset:
        """The common preset, but for what is this row's own affair."""
        return dataclasses.replace(common, small_share=1.0) if self.half_size else common


def _v2(fusion_stage: int = 2, *, dynamic: bool = True) -> LearnedRow:
    def make(width: float, preset: TrainingPreset) -> DetectorTraining:
        return StairNetTraining(width, dataclasses.replace(preset, dynamic_weights=dynamic), fusion_stage)

    return LearnedRow(make)


def _other_fusion(network: type[ConcatenatingStairNet | FourChannelStairNet]) -> LearnedRow:
    return LearnedRow(lambda width, preset: StairNetTraining(width, preset, network=network(width)))


# In the order of training, the rows of table 6 first.
LEARNED_ROWS: dict[str, LearnedRow] = {
    "stairnetv2": _v2(),
    "stairnet": LearnedRow(MonocularTraining, stairnet_arrays),
    "roi": LearnedRow(RoiTraining, roi_arrays, half_size=True),
    "stairnetv2_fixed_weights": _v2(dynamic=False),
    "stairnetv2_fusion_3": _v2(3),
    "stairnetv2_fusion_4": _v2(4),
    "concatenation": _other_fusion(ConcatenatingStairNet),
    "four_channels": _other_fusion(FourChannelStairNet),
}


@dataclass(frozen=True)
class Run:
    """One training.

    Attributes:
        row: key of `LEARNED_ROWS`.
        seed: of weights, order and augmentation.
        width: channel width factor.
        preset: how to train, common to all rows; dynamic weights and the size of frames are the row's own affair.
        data: labelled set with `train` and `val`.
        folder: of all runs.
    """

    row: str
    seed: int
    width: float
    preset: TrainingPreset
    data: Path
    folder: Path

    @naming_fields
    def __post_init__(self) -> None:
        if self.row not in LEARNED_ROWS:
            raise ValueError(f"row={self.row!r} must be one of {', '.join(LEARNED_ROWS)}")

    @property
    def path(self) -> Path:
        """Folder of this run."""
        return self.folder / f"{self.row}_s{self.seed}"

    @property
    def is_done(self) -> bool:
        """Whether its weights are there."""
        return (self.path / WEIGHTS_FILE).is_file()

    def settings(self) -> dict[str, Any]:
        """What a run must agree on to be gone on with, JSON-able."""
        training = dataclasses.asdict(LEARNED_ROWS[self.row].preset(self.preset))
        del training["dynamic_weights"]
        plain = {"row": self.row, "seed": self.seed, "width": self.width, "data": self.data.name, **training}
        settings: dict[str, Any] = json.loads(json.dumps(plain))
        return settings

    def check_settings(self) -> None:
        """Raise RunError when the folder holds a run with other settings."""
        path = self.path / SETTINGS_FILE
        if not path.is_file():
            return
        defaults = {field.name: field.default for field in dataclasses.fields(TrainingPreset)}  # of younger settings
        there, wanted = defaults | read_json_object(path), self.settings()
        other = [
            f"{name} {there.get(name)} instead of {value}" for name, value in wanted.items() if there.get(name) != value
        ]
        if other:
            raise RunError(
                f"{self.path} was trained with {'; '.join(other)}: choose another --runs folder, or those values"
            )


def train_missing(runs: Iterable[Run], *, workers: int = 0, progress: bool = True) -> Iterator[Run]:
    """Train the runs that have no weights yet, each from scratch or from its last checkpoint.

    Args:
        runs: wanted.
        workers: processes that read frames; 0 reads in this process.
        progress: whether the trainer shows its bar.

    Yields:
        Each run, once its weights are there.

    Raises:
        RunError: a folder holds a run with other settings; raised before the first training.
    """
    runs = list(runs)
    for run in runs:
        run.check_settings()
    for run in runs:
        if not run.is_done:
            _train(run, workers, progress)
        yield run


def _train(run: Run, workers: int, progress: bool) -> None:
    import lightning
    from safetensors.torch import save_file

    lightning.seed_everything(run.seed, verbose=False)
    with atomic_path(run.path / SETTINGS_FILE) as temporary:
        temporary.write_text(json.dumps(run.settings(), indent=2) + "\n", encoding="utf-8")
    row = LEARNED_ROWS[run.row]
    preset = row.preset(run.preset)
    frames = FrameModule(run.data, preset, run.seed, workers, VALIDATION_FRAMES, row.encode)
    module = row.make(run.width, preset)
    train(module, frames, run.path, resume=True, progress=progress)
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in module.network.state_dict().items()}
    with atomic_path(run.path / WEIGHTS_FILE) as temporary:
        save_file(tensors, str(temporary))


def load_run(run: Run) -> nn.Module:
    """The trained network of a run, in evaluation mode.

    Raises:
        RunError: it is not trained yet, or its file does not fit.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    path = run.path / WEIGHTS_FILE
    if not path.is_file():
        raise RunError(f"{path}: no such file; the run is not finished")
    network = LEARNED_ROWS[run.row].make(run.width, run.preset).network
    try:
        network.load_state_dict(load_file(str(path)))
    except (SafetensorError, RuntimeError) as error:
        raise RunError(
            f"{path}: not the weights of {run.row} at width {run.width}: {str(error).splitlines()[-1]}"
        ) from None
    return network.eval()
